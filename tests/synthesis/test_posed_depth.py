"""Folders of posed RGB-D and MVSNet's layouts: what is read, and what is refused."""

from __future__ import annotations

from pathlib import Path

import cv2
import numpy as np
import pytest
from depth_folder import METRES, poses, rendered, write_rgbd

from dgc_pose.errors import ImageError, InputError
from dgc_pose.synthesis.depth_scenes import FramePairOptions
from dgc_pose.synthesis.posed_depth import read_rgbd
from dgc_pose.synthesis.render.scene_pair import RenderedPair

_ALL = FramePairOptions(overlap=(0.0, 1.0), baseline=(0.0, 10.0))


@pytest.fixture(scope="module")
def pair() -> RenderedPair:
    return rendered(0, (60, 48))


def test_rgbd_is_read_in_order_and_in_metres(pair: RenderedPair, tmp_path: Path) -> None:
    frames = read_rgbd(write_rgbd(tmp_path / "walk", pair))
    assert [frame.image.name for frame in frames] == ["00003.png", "00017.png"]
    for frame, depth, pose in zip(frames, (pair.depth1, pair.depth2), poses(pair), strict=True):
        np.testing.assert_allclose(frame.read_depth(), METRES * depth, atol=6e-4)
        np.testing.assert_allclose(frame.cam_from_world, pose, atol=1e-9)
        np.testing.assert_allclose(frame.K, pair.K1)


def _damage(root: Path, what: str) -> None:
    if what == "a frame lacks":
        (root / "depth" / "00017.png").unlink()
    elif what == "another size":
        cv2.imwrite(str(root / "depth" / "00017.png"), np.ones((24, 30), np.uint16))
    elif what == "no images":
        for path in (root / "images").iterdir():
            path.unlink()
    elif what == "no folder":
        (root / "depth").rename(root / "elsewhere")
    elif what == "K":
        (root / "K.txt").write_text("1 2 3")
    elif what == "skew":
        np.savetxt(root / "K.txt", [[50, 9, 30], [0, 50, 24], [0, 0, 1]])
    elif what in ("pose", "huge pose"):
        scaled = np.loadtxt(root / "poses.txt")
        scaled[1, :11] *= 2 if what == "pose" else 1e300
        np.savetxt(root / "poses.txt", scaled)
    elif what == "not a number":
        (root / "poses.txt").write_text("nan " * 32)


@pytest.mark.parametrize(
    ("what", "message"),
    [
        ("a frame lacks", "2 images, 1 depths and 2 poses"),
        ("another size", "00017.png is not of the size of 00017.png"),
        ("no images", "images: holds no .jpg"),
        ("no folder", "depth: no such folder"),
        ("K", "K.txt"),
        ("skew", "K.txt: K must be"),
        ("pose", "poses.txt:2: a pose must be"),
        ("huge pose", "poses.txt:2: a pose must be"),  # and no warning of an overflow
        ("not a number", "poses.txt: the numbers must be finite"),
    ],
)
def test_a_damaged_folder_is_refused_in_one_line(
    pair: RenderedPair, tmp_path: Path, what: str, message: str
) -> None:
    root = write_rgbd(tmp_path / "walk", pair)
    _damage(root, what)
    with pytest.raises(InputError, match=message) as error:
        read_rgbd(root)
    assert "\n" not in str(error.value)


def test_unreadable_depth_is_named(pair: RenderedPair, tmp_path: Path) -> None:
    frames = read_rgbd(write_rgbd(tmp_path / "walk", pair))
    frames[0].depth.write_bytes(b"no image")
    frames[1].depth.unlink()
    for frame in frames:
        with pytest.raises(ImageError, match=frame.depth.name):
            frame.read_depth()
