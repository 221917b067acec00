import json
import os

import cv2
import numpy as np
import pytest
import torch
from command_line import assert_refused, run
from map_nets import MapNet, half_sure, shifted
from procedural import procedural_textures


@pytest.fixture
def folder(tmp_path, monkeypatch):
    """Photographs, of which some are held back; `still` says that nothing moved."""
    monkeypatch.chdir(tmp_path)
    os.makedirs("photos")
    textures = (255 * procedural_textures(4, 64, seed=1)).round().to(torch.uint8)
    for index in range(40):
        pixels = textures[index % 4].permute(1, 2, 0).numpy()
        cv2.imwrite(f"photos/{index:02d}.png", np.roll(pixels, index, 1))
    nets = {"still": MapNet(shifted(0, 0), half_sure()), "off": MapNet(shifted(300, 0))}
    monkeypatch.setattr(
        "dgc_pose.benchmarks.map_run.load_network", lambda weights, device: nets[weights]
    )
    return tmp_path


def bench(*arguments):
    return run("bench-synthetic", "--photos", "photos", *arguments)


def test_a_table_a_set_with_a_line_a_method(folder):
    result = bench(
        "--methods", "still,off", "--sets", "affine, homography", "--pairs", "3", "--json", "s.json"
    )
    assert result.exit_code == 0, result.output
    assert result.stderr == ""
    data = json.loads((folder / "s.json").read_text())
    still, off = data["methods"]
    assert [group["group"] for group in still["groups"]] == ["affine", "homography"]
    assert [group["pairs"] for group in still["groups"]] == [3, 3]
    assert still["all"]["aepe"] < 100 < off["all"]["aepe"]
    assert off["reliability"] is None and sum(still["reliability"]["counts"]) == 6 * 240 * 240
    lines = result.stdout.splitlines()
    for group in still["groups"]:
        (at,) = [n for n, own in enumerate(lines) if own.split()[:2] == [group["group"], "pairs"]]
        assert lines[at + 1].split()[:3] == ["still", "3", f"{group['aepe']:.2f}"]
        assert lines[at + 2].split()[0] == "off"
    held_back = data["photographs"]
    assert 1 <= held_back < 10 and lines[0].startswith(f"{held_back} photographs")
    assert "no occluders" in lines[0]


def test_scenes_and_changes_of_light_with_all_files(folder):
    result = bench(
        "--methods", "still", "--sets", "scenes", "--pairs", "2", "--changed", "--out", "run"
    )
    assert result.exit_code == 0, result.output
    assert "with changes of light" in result.stdout
    names = ["pairs.csv", "pck.png", "reliability.png", "summary.json"]
    assert sorted(os.listdir("run")) == names


@pytest.mark.parametrize(
    "arguments, words",
    [
        (("--sets", "affine,tps"), "no set 'tps'"),
        (("--sets", ","), "no sets"),
        (("--photos", "nowhere"), "nowhere: No such file or directory"),
    ],
)
def test_unusable_input_is_one_line_and_writes_nothing(folder, arguments, words):
    if "--methods" not in arguments:
        arguments = (*arguments, "--methods", "still")
    assert_refused(bench(*arguments), words)
    assert os.listdir(folder) == ["photos"]
