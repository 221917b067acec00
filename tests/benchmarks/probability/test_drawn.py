"""Pairs drawn from posed scenes."""

from dataclasses import replace
from pathlib import Path

import cv2
import numpy as np
import pycolmap
import pytest
from dtu_layout import grey_scan, write_raw
from scipy.spatial.transform import Rotation

from dgc_pose.benchmarks.probability.drawn import (
    drawn_dtu,
    drawn_posed,
    drawn_rgbd,
    drawn_sparse,
)
from dgc_pose.benchmarks.probability.plan import PlanEntry
from dgc_pose.benchmarks.probability.planned import planned
from dgc_pose.errors import InputError
from dgc_pose.metrics import rotation_error_deg

SIZE = (64, 48)
K = np.array([[60.0, 0, 31.5], [0, 60, 23.5], [0, 0, 1]])


def _poses(count: int) -> list[np.ndarray]:
    """World-from-camera: an orbit about a point 2 in front, 8 degrees apart."""
    poses = []
    for k in range(count):
        T = np.eye(4)
        T[:3, :3] = Rotation.from_euler("y", 8 * k, degrees=True).as_matrix()
        T[:3, 3] = np.array([0, 0, 2.0]) - T[:3, :3] @ (0, 0, 2.0)
        poses.append(T)
    return poses


def _rgbd(folder, poses) -> None:
    """Frames of a wall at a depth of 2; only poses and depths matter."""
    for name in ("images", "depth"):
        (folder / name).mkdir(parents=True)
    for k in range(len(poses)):
        cv2.imwrite(str(folder / f"images/{k:03d}.png"), np.zeros((48, 64, 3), np.uint8))
        cv2.imwrite(str(folder / f"depth/{k:03d}.png"), np.full((48, 64), 2000, np.uint16))
    np.savetxt(folder / "K.txt", K)
    np.savetxt(folder / "poses.txt", np.array(poses).reshape(-1, 16))


def test_pairs_of_frames_carry_their_pose_and_spread_over_rotations(tmp_path) -> None:
    poses = _poses(10)
    _rgbd(tmp_path, poses)
    pairs = drawn_rgbd(tmp_path, 30, seed=1)
    assert len(pairs) == len({(one.name1, one.name2) for one in pairs}) == 30
    for pair in pairs:
        i, j = (int(name[7:10]) for name in (pair.name1, pair.name2))
        T = np.linalg.inv(poses[j]) @ poses[i]
        np.testing.assert_allclose(pair.R, T[:3, :3], atol=1e-6)
        np.testing.assert_allclose(pair.t, T[:3, 3], atol=1e-6)
        assert pair.path1.is_file()
    angles = [rotation_error_deg(pair.R, np.eye(3)) for pair in pairs]
    assert np.histogram(angles, (0, 10, 20, 30, 45, 90))[0].min() >= 3
    again = drawn_rgbd(tmp_path, 30, seed=1)
    assert [one.name1 for one in again] == [one.name1 for one in pairs]
    assert [one.name1 for one in drawn_rgbd(tmp_path, 30, seed=2)] != [p.name1 for p in pairs]


def test_frames_from_one_place_make_no_pair(tmp_path) -> None:
    _rgbd(tmp_path, [np.eye(4)] * 3)
    assert drawn_rgbd(tmp_path, 10, seed=0) == []


def test_pairs_of_posed_scenes_are_wide_and_share_what_both_see(tmp_path) -> None:
    away = np.diag([-1.0, 1, -1, 1])  # of a camera that sees nothing of the others'
    poses = [*_poses(10), away]
    for scene in ("one", "two"):
        _rgbd(tmp_path / scene, poses)
        lines = []
        for k, pose in enumerate(poses):
            pose = np.linalg.inv(pose)[:3]
            numbers = [60, 60, 31.5, 23.5, *pose.ravel(), 1.5, 2.5]
            lines.append(" ".join([f"{k:03d}.png", *map(repr, map(float, numbers))]))
        (tmp_path / scene / "poses.txt").unlink()
        (tmp_path / scene / "cameras.txt").write_text("\n".join(lines))
    pairs = drawn_posed(tmp_path, 20, seed=1)
    assert [pair.name1[:3] for pair in pairs] == ["one"] * 20 + ["two"] * 20
    assert len({(pair.name1, pair.name2) for pair in pairs}) == 40
    for pair in pairs:
        i, j = (int(name[11:14]) for name in (pair.name1, pair.name2))
        T = np.linalg.inv(poses[j]) @ poses[i]
        np.testing.assert_allclose(pair.R, T[:3, :3], atol=1e-6)
        np.testing.assert_allclose(pair.t, T[:3, 3], atol=1e-6)
        assert pair.path1.is_file() and max(i, j) < 10
    angles = [rotation_error_deg(pair.R, np.eye(3)) for pair in pairs]
    assert np.median(angles) > 20
    again = drawn_posed(tmp_path, 20, seed=1)
    assert [one.name1 for one in again] == [one.name1 for one in pairs]
    entry = PlanEntry("posed", "fit", "posed", (Path("."),), 20, 1, True, without=("one",))
    left = planned(entry, tmp_path, tmp_path / "lists")
    assert [pair.scene for pair in left] == ["two"] * 20
    with pytest.raises(InputError, match="no pairs of three, which without names"):
        planned(replace(entry, without=("three",)), tmp_path, tmp_path / "others")


def test_a_scene_with_a_sensors_depth_has_pairs_by_its_paths(tmp_path) -> None:
    _rgbd(tmp_path / "hall", _poses(6))
    for folder in ("images", "depth"):
        (tmp_path / "hall" / folder / "left").mkdir()
        for path in (tmp_path / "hall" / folder).glob("*.png"):
            path.rename(path.parent / "left" / path.name)
    for root, start in ((tmp_path, "hall/images/left/"), (tmp_path / "hall", "images/left/")):
        pairs = drawn_posed(root, 5, seed=0)
        assert len(pairs) == 5
        for pair in pairs:
            assert pair.name1.startswith(start) and pair.path1.is_file() and pair.path2.is_file()


def _model(folder, *, camera_model: str = "PINHOLE") -> list[np.ndarray]:
    """A COLMAP model of an orbit, whose neighbours share points; world-from-camera."""
    poses = _poses(5)
    model = pycolmap.Reconstruction()
    parameters = [60, 60, 32, 24] + [0.1] * (0 if camera_model == "PINHOLE" else 4)
    model.add_camera_with_trivial_rig(
        pycolmap.Camera(camera_id=1, model=camera_model, width=64, height=48, params=parameters)
    )
    rng = np.random.default_rng(0)
    for k, pose in enumerate(poses):
        inverse = np.linalg.inv(pose)
        points = [pycolmap.Point2D(xy) for xy in rng.random((40, 2)) * SIZE]
        image = pycolmap.Image(name=f"{k}.jpg", camera_id=1, image_id=k + 1, points2D=points)
        model.add_image_with_trivial_frame(
            image, pycolmap.Rigid3d(pycolmap.Rotation3d(inverse[:3, :3]), inverse[:3, 3])
        )
    for n in range(40):
        track = pycolmap.Track()
        for k in (n % 4, n % 4 + 1):
            track.add_element(k + 1, n)
        model.add_point3D(np.array([0, 0, 2.0]), track)
    folder.mkdir(parents=True, exist_ok=True)
    model.write_text(str(folder))
    return poses


def test_pairs_of_a_colmap_model_carry_its_poses_in_our_pixels(tmp_path) -> None:
    poses = _model(tmp_path)
    pairs = drawn_sparse(tmp_path, 20, seed=0)
    assert len(pairs) >= 8
    for pair in pairs:
        i, j = (int(name[7]) for name in (pair.name1, pair.name2))
        T = np.linalg.inv(poses[j]) @ poses[i]
        np.testing.assert_allclose(pair.R, T[:3, :3], atol=1e-6)
        np.testing.assert_allclose(pair.t, T[:3, 3], atol=1e-6)
        np.testing.assert_allclose(pair.camera1.K[:2, 2], (31.5, 23.5))


def test_a_model_with_distortion_and_a_folder_without_a_model_are_refused(tmp_path) -> None:
    with pytest.raises(InputError, match="no COLMAP model"):
        drawn_sparse(tmp_path / "none", 5, seed=0)
    _model(tmp_path / "bent", camera_model="OPENCV")
    with pytest.raises(InputError, match="OPENCV has distortion"):
        drawn_sparse(tmp_path / "bent", 5, seed=0)


def test_dtu_pairs_have_their_poses(tmp_path):
    scan = grey_scan([0, 20, 50, 90])
    write_raw(tmp_path, scan)
    drawn = drawn_dtu(tmp_path, 10, 0)
    # Of the differences 20 50 90 30 70 40 those up to 60 degrees.
    rotations = [rotation_error_deg(pair.R, np.eye(3)) for pair in drawn]
    assert sorted(rotations) == pytest.approx([20, 30, 40, 50])
    for pair in drawn:
        assert pair.root == tmp_path and pair.path1.is_file() and pair.path2.is_file()
