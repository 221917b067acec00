"""The rates of the generator: a figure for each kind that can be made."""

from __future__ import annotations

from pathlib import Path

import cv2
import numpy as np
from click.testing import CliRunner
from depth_folder import rendered, write_rgbd

from dgc_pose.render.procedural import procedural_textures
from dgc_pose.training.rates import main

_SMALL = ["--seconds", "0", "--size", "32", "--batch", "2", "--device", "cpu"]


def _write_photos(folder: Path) -> Path:
    folder.mkdir()
    for index, texture in enumerate(procedural_textures(40, 64, seed=0)):
        pixels = (255 * texture.permute(1, 2, 0).numpy()).astype(np.uint8)
        cv2.imwrite(str(folder / f"{index:03d}.png"), pixels)
    return folder


def test_each_kind_has_its_rate(tmp_path: Path) -> None:
    arguments = ["--photos", str(_write_photos(tmp_path / "photos")), *_SMALL]
    lines = CliRunner().invoke(main, arguments, catch_exceptions=False).output.splitlines()
    assert [line.split("  ")[0] for line in lines[1:]] == ["warped photographs", "ray-cast scenes"]
    root = write_rgbd(tmp_path / "walk", rendered(3, (64, 64)))
    result = CliRunner().invoke(main, [*arguments, "--rgbd", str(root)], catch_exceptions=False)
    rates = [line.split()[-2:] for line in result.output.splitlines()[1:]]
    assert len(rates) == 3 and all(float(rate) > 0 and unit == "pairs/s" for rate, unit in rates)


def test_a_folder_without_depth_is_refused_in_one_line(tmp_path: Path) -> None:
    arguments = ["--photos", str(_write_photos(tmp_path / "photos")), *_SMALL]
    result = CliRunner().invoke(main, [*arguments, "--rgbd", str(tmp_path / "none")])
    assert result.exit_code == 1
    missing = tmp_path / "none" / "images"
    assert result.output.splitlines()[-1] == f"Error: {missing}: no such folder"
