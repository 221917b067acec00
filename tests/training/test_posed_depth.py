"""Folders of posed RGB-D and MVSNet's layouts: what is read, and what is refused."""

from __future__ import annotations

from pathlib import Path

import cv2
import numpy as np
import pytest
from depth_folder import METRES, cam_text, pfm, poses, rendered, write_rgbd

from dgc_pose.errors import ImageError, InputError
from dgc_pose.render.scene_pair import RenderedPair
from dgc_pose.training.depth_scenes import PairChoice, load_depth_scenes
from dgc_pose.training.mvsnet import read_cam, read_mvsnet_dtu, read_mvsnet_folder
from dgc_pose.training.posed_depth import read_rgbd

_ALL = PairChoice(overlap=(0.0, 1.0), baseline=(0.0, 10.0))


@pytest.fixture(scope="module")
def pair() -> RenderedPair:
    return rendered(0, (60, 48))


def test_rgbd_is_read_in_order_and_in_metres(pair: RenderedPair, tmp_path: Path) -> None:
    frames = read_rgbd(write_rgbd(tmp_path / "walk", pair))
    assert [frame.image.name for frame in frames] == ["00003.png", "00017.png"]
    for frame, depth, pose in zip(frames, (pair.depth1, pair.depth2), poses(pair), strict=True):
        np.testing.assert_allclose(frame.read_depth(), METRES * depth, atol=6e-4)
        np.testing.assert_allclose(frame.cam_from_world, pose, atol=1e-9)
        np.testing.assert_allclose(frame.image_K, pair.K1)


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
    elif what == "pose":
        scaled = np.loadtxt(root / "poses.txt")
        scaled[1, :11] *= 2
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
        ("K", "K.txt: expected 3x3 numbers"),
        ("skew", "K.txt: K must be"),
        ("pose", "poses.txt:2: a pose must be"),
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


def _write_folder(root: Path, pair: RenderedPair, names: tuple[str, str]) -> None:
    images, depths = (root / name for name in names)
    for folder in (images, depths, root / "cams"):
        folder.mkdir(parents=True)
    views = ((pair.image1, pair.depth1), (pair.image2, pair.depth2))
    for number, ((image, depth), pose) in enumerate(zip(views, poses(pair), strict=True)):
        cv2.imwrite(str(images / f"{number:08d}.png"), image[..., ::-1])
        (depths / f"{number:08d}.pfm").write_bytes(pfm(METRES * depth))
        (root / "cams" / f"{number:08d}_cam.txt").write_text(cam_text(pair.K1, pose))
    # A camera without depth is passed over.
    (root / "cams" / "00000002_cam.txt").write_text(cam_text(pair.K1, poses(pair)[0]))


@pytest.mark.parametrize(
    "names", [("images", "depths"), ("blended_images", "rendered_depth_maps")]
)
def test_a_folder_a_scene_gives_the_frames(
    pair: RenderedPair, tmp_path: Path, names: tuple[str, str]
) -> None:
    _write_folder(tmp_path / "scene", pair, names)
    frames = read_mvsnet_folder(tmp_path / "scene")
    assert len(frames) == 2
    for frame, depth, pose in zip(frames, (pair.depth1, pair.depth2), poses(pair), strict=True):
        np.testing.assert_allclose(frame.read_depth(), METRES * depth, rtol=1e-6)
        np.testing.assert_allclose(frame.cam_from_world, pose, atol=1e-12)
        np.testing.assert_allclose(frame.image_K, pair.K1)
        np.testing.assert_allclose(frame.depth_K, pair.K1)


def test_both_layouts_of_one_scene_load_the_same(pair: RenderedPair, tmp_path: Path) -> None:
    _write_folder(tmp_path / "scene", pair, ("images", "depths"))
    one = load_depth_scenes([read_mvsnet_folder(tmp_path / "scene")], _ALL, side=40)
    two = load_depth_scenes([read_rgbd(write_rgbd(tmp_path / "walk", pair))], _ALL, side=40)
    assert (one.images == two.images).all() and (one.pairs == two.pairs).all()
    np.testing.assert_allclose(one.depth, two.depth, atol=4e-3)
    np.testing.assert_allclose(one.source_from_target, two.source_from_target, atol=1e-3)


def test_dtu_as_mvsnet_prepared_it(pair: RenderedPair, tmp_path: Path) -> None:
    """Depth is a quarter of the image; K is in pixels of the depth, the image's 4 times that."""
    for folder in ("Cameras/train", "Depths/scan2_train", "Rectified/scan2_train"):
        (tmp_path / folder).mkdir(parents=True)
    for number, pose in enumerate(poses(pair)):
        cam = tmp_path / "Cameras" / "train" / f"{number:08d}_cam.txt"
        cam.write_text(cam_text(pair.K1, pose))
        depth = tmp_path / "Depths" / "scan2_train" / f"depth_map_{number:04d}.pfm"
        depth.write_bytes(pfm(np.full((48, 60), 600.0)))
        image = tmp_path / "Rectified" / "scan2_train" / f"rect_{number + 1:03d}_3_r5000.png"
        cv2.imwrite(str(image), np.zeros((192, 240, 3), np.uint8))
    frames = read_mvsnet_dtu(tmp_path, 2)
    assert [frame.image.name[:8] for frame in frames] == ["rect_001", "rect_002"]
    np.testing.assert_allclose(frames[0].depth_K, pair.K1)
    np.testing.assert_allclose(frames[0].image_K, np.diag([4, 4, 1]) @ pair.K1)
    assert (frames[1].read_depth() == 600).all()
    with pytest.raises(InputError, match="scan7_train: holds no"):
        read_mvsnet_dtu(tmp_path, 7)
    frames[0].image.unlink()
    with pytest.raises(ImageError, match="rect_001_3_r5000.png is missing"):
        read_mvsnet_dtu(tmp_path, 2)


@pytest.mark.parametrize(
    "text", ["", "extrinsic 1 2", "extrinsic\n" + "x " * 16 + "\nintrinsic\n" + "1 " * 9]
)
def test_a_cam_file_that_is_none_is_refused(tmp_path: Path, text: str) -> None:
    path = tmp_path / "00000000_cam.txt"
    path.write_text(text)
    with pytest.raises(InputError, match="00000000_cam.txt: "):
        read_cam(path)


def test_a_pfm_that_is_none_is_refused(pair: RenderedPair, tmp_path: Path) -> None:
    _write_folder(tmp_path / "scene", pair, ("images", "depths"))
    (tmp_path / "scene" / "depths" / "00000001.pfm").write_bytes(b"PF\n60 48\n-1\n")
    with pytest.raises(ImageError, match="00000001.pfm is not a PFM image of one channel"):
        read_mvsnet_folder(tmp_path / "scene")
