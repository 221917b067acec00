"""Folders of posed RGB-D and MVSNet's layouts: what is read, and what is refused."""

from collections.abc import Callable
from pathlib import Path

import cv2
import numpy as np
import pytest
from depth_folder import METRES, poses, rendered, write_rgbd

from dgc_pose.errors import ImageError, InputError
from dgc_pose.training.synthesis.posed_depth import read_rgbd
from dgc_pose.training.synthesis.render.rendered_pairs import RenderedPair


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


def _scaled_pose(root: Path, factor: float) -> None:
    poses = np.loadtxt(root / "poses.txt")
    poses[1, :11] *= factor
    np.savetxt(root / "poses.txt", poses)


@pytest.mark.parametrize(
    ("damage", "message"),
    [
        (lambda r: (r / "depth/00017.png").unlink(), "2 images, 1 depths and 2 poses"),
        (
            lambda r: cv2.imwrite(str(r / "depth/00017.png"), np.ones((24, 30), np.uint16)),
            "00017.png is not of the size of 00017.png",
        ),
        (lambda r: [p.unlink() for p in (r / "images").iterdir()], "images: holds no .jpg"),
        (lambda r: (r / "depth").rename(r / "elsewhere"), "depth: no such folder"),
        (lambda r: (r / "K.txt").write_text("1 2 3"), "K.txt"),
        (lambda r: (r / "K.txt").write_text("50 9 30 0 50 24 0 0 1"), "K.txt: K must be"),
        (lambda r: _scaled_pose(r, 2), "poses.txt:2: a pose must be"),
        (lambda r: _scaled_pose(r, 1e300), "poses.txt:2: a pose must be"),  # without an overflow
        (lambda r: (r / "poses.txt").write_text("nan " * 32), "the numbers must be finite"),
    ],
)
def test_a_damaged_folder_is_refused_in_one_line(
    pair: RenderedPair, tmp_path: Path, damage: Callable[[Path], object], message: str
) -> None:
    root = write_rgbd(tmp_path / "walk", pair)
    damage(root)
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
