"""The photographs that training holds back, on their own."""

from pathlib import Path

import cv2
import numpy as np
import pytest
import torch

from dgc_pose.errors import ImageError
from dgc_pose.training.synthesis.photos import load_held_back, load_photos


@pytest.fixture
def folder(tmp_path: Path) -> Path:
    rng = np.random.default_rng(0)
    for index in range(60):
        pixels = rng.integers(0, 255, (20, 30, 3), dtype=np.uint8)
        cv2.imwrite(str(tmp_path / f"p{index:03d}.png"), pixels)
    return tmp_path


def test_they_are_those_that_the_trainer_holds_back(folder: Path) -> None:
    (folder / "broken.jpg").write_bytes(b"no photograph")
    training, held_back = load_photos(folder, side=16)
    assert len(training.pixels) + len(held_back.pixels) == 60 and 1 <= len(held_back.pixels) < 12
    assert torch.equal(training.pixels, load_photos(folder, side=16)[0].pixels)
    known = {planes.numpy().tobytes() for planes in training.pixels}
    assert not any(planes.numpy().tobytes() in known for planes in held_back.pixels)
    assert torch.equal(load_held_back(folder, side=16).pixels, held_back.pixels)
    assert load_held_back(folder, side=24).pixels.shape[1:] == (3, 24, 24)


def test_a_folder_without_any_is_named(folder: Path, tmp_path: Path) -> None:
    for path in tmp_path.glob("*.png"):
        if path.name != "p000.png":
            path.unlink()
    with pytest.raises(ImageError, match="1 photographs, none of them held back"):
        load_held_back(folder)
