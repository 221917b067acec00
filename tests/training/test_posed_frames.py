"""Folders of posed photographs: what is read, and what is refused."""

from pathlib import Path

import cv2
import numpy as np
import pytest
from rendered import RenderedPair, poses, rendered, write_rgbd
from worlds import world_scene, write_colmap

from dgc_pose.errors import ImageError, InputError
from dgc_pose.training.posed_frames import read_rgbd, read_scene, read_scenes


@pytest.fixture(scope="module")
def pair():
    return rendered(0, (60, 48))


def write_listed(root: Path, pair: RenderedPair, *, depth: bool = True) -> Path:
    """The pair in the layout with cameras.txt; its depth has 5,000 steps a metre."""
    write_rgbd(root, pair)
    lines = []
    for name, pose in zip(("00003", "00017"), poses(pair), strict=True):
        K = pair.K1[0, 0], pair.K1[1, 1], pair.K1[0, 2], pair.K1[1, 2]
        values = [*K, *pose[:3].ravel(), 0.5, 9.0]
        lines.append(" ".join([f"{name}.png", *map(repr, map(float, values))]))
        path = root / f"depth/{name}.png"
        cv2.imwrite(str(path), 5 * cv2.imread(str(path), cv2.IMREAD_UNCHANGED))
    (root / "cameras.txt").write_text("\n".join(lines) + "\n")
    for name in ("poses.txt", "K.txt"):
        (root / name).unlink()
    if depth:
        (root / "depth_scale.txt").write_text("5000\n")
    return root


@pytest.mark.parametrize("write", [write_rgbd, write_listed])
def test_sensors_depths_are_read_in_order_and_in_metres(pair, tmp_path, write):
    write(tmp_path / "walk", pair)
    (tmp_path / "no_scene").mkdir()
    (frames,) = read_scenes(tmp_path).values()
    assert [frame.image.name for frame in frames] == ["00003.png", "00017.png"]
    for frame, depth, pose in zip(frames, (pair.depth1, pair.depth2), poses(pair), strict=True):
        np.testing.assert_allclose(frame.read_depth(), depth, atol=6e-4)
        np.testing.assert_allclose(frame.cam_from_world, pose, atol=1e-9)
        np.testing.assert_allclose(frame.camera.K, pair.K1)


def test_a_colmap_model_has_cameras_poses_and_reach(tmp_path):
    scene = world_scene()
    write_colmap(scene, tmp_path / "sparse/0")  # its points are in the first two images
    (tmp_path / "images").mkdir()
    for name in scene.names:
        cv2.imwrite(str(tmp_path / "images" / name), np.zeros((800, 1000, 3), np.uint8))
    frames = read_scene(tmp_path)
    assert [frame.image.name for frame in frames] == scene.names[:2]
    for frame, (R, centre) in zip(frames, scene.references, strict=False):
        np.testing.assert_allclose(frame.camera.K, scene.model().cameras[frame.image.name].K)
        pose = np.column_stack([R, -R @ centre])
        np.testing.assert_allclose(frame.cam_from_world[:3], pose, atol=1e-12)
        depths = (scene.points - centre) @ R[2]
        assert frame.reach is not None
        nearest, farthest = frame.reach
        assert 0.7 < nearest / depths.min() < 1 and 1 < farthest / depths.max() < 1.3


@pytest.mark.parametrize(
    ("damage", "message"),
    [
        (lambda r: (r / "depth/00017.png").unlink(), "2 images, 1 depths and 2 poses"),
        (lambda r: (r / "poses.txt").write_text("1 2 3"), "rows of 16 numbers"),
        (
            lambda r: np.savetxt(r / "poses.txt", [np.eye(4).ravel(), 2 * np.eye(4).ravel()]),
            "00017.png: its pose",
        ),
        (lambda r: np.savetxt(r / "K.txt", [[9, 1, 5], [0, 9, 5], [0, 0, 1]]), "without skew"),
    ],
)
def test_a_damaged_folder_is_named(pair, tmp_path, damage, message):
    root = write_rgbd(tmp_path / "walk", pair)
    damage(root)
    with pytest.raises((InputError, OSError), match=message):
        read_rgbd(root)


def test_a_wrong_line_of_cameras_is_named(pair, tmp_path):
    path = write_listed(tmp_path / "walk", pair, depth=False) / "cameras.txt"
    text = path.read_text()
    path.write_text(text + "\n")  # a blank line is no frame
    frames = read_scene(tmp_path / "walk")
    assert [(frame.reach, frame.depth) for frame in frames] == [((0.5, 9.0), None)] * 2
    for changed, message in (
        (text + "x.png 1 2\n", r"cameras.txt:3 cannot be read as a name and 18 numbers"),
        (text.replace("0.5 9.0", "9.0 0.5", 1), "cameras.txt:1: .* the depths must"),
        (text.replace("png ", "png -", 1), "cameras.txt:1: fx, fy and the depths must"),
        ("\n" + text.splitlines()[0], "walk: 1 frames of known pose and depth"),
    ):
        path.write_text(changed)
        with pytest.raises(InputError, match=message):
            read_scene(tmp_path / "walk")


def test_no_scenes_and_depths_of_another_kind_are_refused(pair, tmp_path, monkeypatch):
    with pytest.raises(InputError, match="has no scenes"):
        read_scenes(tmp_path)
    monkeypatch.chdir(write_rgbd(tmp_path / "walk", pair))
    (frame, _) = read_scenes(".")["walk"]
    small = np.arange(720, dtype=np.uint16).reshape(24, 30)
    cv2.imwrite(str(frame.depth), small)
    np.testing.assert_allclose(1000 * frame.read_depth(), small.repeat(2, 0).repeat(2, 1), 1e-6)
    for depth, error, message in (
        (small[:20], InputError, "depth/00003.png has 30 x 20, its image 60 x 48 pixels"),
        (np.zeros((48, 60, 3), np.uint8), ImageError, "one channel"),
    ):
        cv2.imwrite(str(frame.depth), depth)
        with pytest.raises(error, match=message):
            frame.read_depth()
