"""Located cameras of a synthetic model, whose observations and true poses are known."""

from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import PIL.Image
import pycolmap
import pytest
from PIL import ExifTags
from scipy.spatial.transform import Rotation

from dgc_pose.cameras.camera import Camera, colmap_camera
from dgc_pose.cameras.colmap_camera import RADIAL, Distortion
from dgc_pose.localization.location import DatabaseImage, Location
from dgc_pose.matches import Matches
from dgc_pose.metrics import rotation_error_deg
from dgc_pose.model import Model, load_model, upright_model
from dgc_pose.rigs.adjustment import adjusted, bundle_camera, extended, start_camera

CAMERA = Camera(np.array([[700.0, 0, 410], [0, 700, 290], [0, 0, 1]]), (800, 600))
NOISE_PX, STDS = 0.1, np.repeat([5e-4, 3e-3], 3)  # of the located poses: radians and units


def synthetic(images: int, points: int, **options: Any) -> pycolmap.Reconstruction:
    """COLMAP's own synthetic model."""
    pycolmap.set_random_seed(0)
    counts = {"num_rigs": 1, "num_frames_per_rig": images, "num_points3D": points}
    return pycolmap.synthesize_dataset(pycolmap.SyntheticDatasetOptions(**counts, **options))


def turned(R: np.ndarray, rng: np.random.Generator, std: float) -> np.ndarray:
    return Rotation.from_rotvec(rng.normal(0, std, 3)).as_matrix() @ R


def matched(model: Model, name: str, points: np.ndarray, seen: np.ndarray) -> Matches:
    """The matches of an image of the model with what a camera sees, one in ten wrong."""
    which, pixels = model.seen[name]
    _, first, second = np.intersect1d(which, points, return_indices=True)
    return Matches(pixels[first], seen[second], np.ones(len(first)), 0.5)


def seen_by(model: Model, near: str, seed: int) -> tuple[Location, Location]:
    """The truth of a camera near one of the model's, and its location with errors. It sees the
    points with noise, and one in ten somewhere, some by two of the model's images."""
    rng, size = np.random.default_rng(seed), CAMERA.size
    R = turned(model.poses[near][:, :3], rng, 0.05)
    centre = model.centre(near) + rng.normal(0, 0.2, 3)
    local = (model.points - centre) @ R.T
    pixels = CAMERA.project(local[:, :2] / local[:, 2:])
    inside = (local[:, 2] > 0) & (pixels > 0).all(1) & (pixels < size).all(1)
    points = rng.permutation(np.flatnonzero(inside))
    seen = pixels[points] + rng.normal(0, NOISE_PX, (len(points), 2))
    wrong = rng.random(len(points)) < 0.1
    seen[wrong] = rng.uniform(0, size, (wrong.sum(), 2))
    parts = (True, np.s_[:150], 0), (True, np.s_[120:], 0), (False, ..., 1.5)
    others = [near, *(name for name in model.poses if name != near)]
    images = []
    for name, (agrees, part, off) in zip(others, parts, strict=False):
        matches = matched(model, name, points, seen)
        inliers = np.ones(len(matches), bool)
        shown = points[part], off + seen[part]
        images.append(DatabaseImage(name, matches, inliers, 0.9, agrees, *shown))
    true = Location("located", "", tuple(images), R=R, centre=centre, camera=CAMERA)
    centre, covariance = centre + rng.normal(0, STDS[3:]), np.diag(STDS**2)
    return true, replace(true, R=turned(R, rng, STDS[0]), centre=centre, covariance=covariance)


@pytest.mark.parametrize(("exact", "orientation"), [(True, 1), (False, 1), (True, 3), (False, 6)])
def test_the_adjusted_poses_are_nearer_to_the_truth(
    tmp_path: Path, exact: bool, orientation: int
) -> None:
    """An exact K stays, another is fitted; the walk keeps its cameras, and wrong observations bend
    nothing. Matches and cameras of the walk are upright, and COLMAP's model is as stored."""
    colmap = synthetic(8, 400, camera_params=[1280, 490, 400, 0.05])
    exif = PIL.Image.Exif()
    exif[ExifTags.Base.Orientation] = orientation
    for image in colmap.images.values():
        stored = PIL.Image.new("RGB", (image.camera.width, image.camera.height))
        stored.save(tmp_path / image.name, "PNG", exif=exif)
    walk = upright_model(colmap, tmp_path)
    cameras = {name: seen_by(walk, name, n) for n, name in enumerate(sorted(walk.poses)[:3])}
    assumed = replace(CAMERA, focal_std=0.01, centre_std=2.0).with_focal(703.0)
    camera = CAMERA if exact else assumed
    located = {
        name: replace(near, camera=camera, stated=camera) for name, (_, near) in cameras.items()
    }
    pictures = {name: tmp_path / f"cam_{name}" for name in cameras}
    for path in pictures.values():
        PIL.Image.new("RGB", CAMERA.size).save(path, "PNG")
    whole, _, found = adjusted(walk, located, pictures, walk.cameras)
    errors = []
    for name, (true, near) in cameras.items():
        location = found[name]
        image = whole.find_image_with_name(pictures[name].name)
        for each in (near, location):
            off = np.linalg.norm(each.centre - true.centre)
            errors.append((rotation_error_deg(each.R, true.R), off))
        np.testing.assert_allclose(
            image.cam_from_world().matrix(), location.cam_from_world, atol=1e-12
        )
        assert image.num_points3D > 60 and location.camera.exact == exact
        # A principal point that is not known by 2 pixels turns the camera.
        assert errors[-1][0] < location.rotation_error_90_deg < (0.1 if exact else 0.5)
        assert errors[-1][1] < location.position_error_90
        np.testing.assert_allclose(location.camera.K, CAMERA.K, atol=1e-9 if exact else 1.5)
    before, after = (np.mean(errors[first::2], axis=0) for first in (0, 1))
    assert after[0] < (0.4 if exact else 0.7) * before[0]
    assert after[1] < (0.4 if exact else 1.5) * before[1]  # a focal length trades with the centre
    for key, theirs in walk.colmap.cameras.items():
        np.testing.assert_array_equal(whole.cameras[key].params, theirs.params)
    assert len(walk.colmap.images) == 8 and len(whole.images) == 11  # the walk is as it was


def test_a_photograph_of_the_walk_may_have_the_name_of_a_camera(tmp_path: Path) -> None:
    """Also where COLMAP's order of the images, which depends on their number, has the camera last:
    the name changes nothing."""
    model = synthetic(12, 200)
    for image in model.images.values():
        image.name = Path(image.name).name
    walk = Model.of_colmap(model, tmp_path)
    located = {name: seen_by(walk, name, 0)[1] for name in sorted(walk.poses)[:3]}
    located = {name: replace(near, stated=CAMERA) for name, near in located.items()}
    poses = []
    for folder, prefix in (("one", "cam_"), ("two", "")):
        pictures = {name: tmp_path / folder / f"{prefix}{name}" for name in located}
        (tmp_path / folder).mkdir()
        for path in [*pictures.values(), *(tmp_path / name for name in walk.poses)]:
            PIL.Image.new("RGB", CAMERA.size).save(path, "PNG")
        _, _, found = adjusted(walk, located, pictures, walk.cameras)
        poses.append(np.stack([location.cam_from_world for location in found.values()]))
    np.testing.assert_array_equal(*poses)


@pytest.mark.parametrize("folder", ["", "images/"])
def test_photographs_with_one_file_name_keep_their_poses(tmp_path: Path, folder: str) -> None:
    """A photograph without a file has no pose, even if another has its file name. COLMAP's names
    may be paths from another folder than that of the photographs."""
    colmap = synthetic(4, 50)
    names = ["a/1.jpg", "b/1.jpg", "c/1.jpg", "c/2.jpg"]
    for number, name in zip(sorted(colmap.images), names, strict=True):
        colmap.images[number].name = folder + name
    (tmp_path / "sparse").mkdir()
    colmap.write_binary(tmp_path / "sparse")
    for name in names[1:]:
        path = tmp_path / "images" / name
        path.parent.mkdir(parents=True, exist_ok=True)
        PIL.Image.new("RGB", (1024, 768)).save(path)
    whole, _ = extended(load_model(tmp_path / "sparse", tmp_path / "images"), {}, {})
    found = {image.name: number for number, image in whole.images.items() if image.has_pose}
    assert found == {f"walk/{name}": n for n, name in enumerate(names[1:], start=2)}


@pytest.mark.parametrize("fy", [700.0, 702.0])
def test_a_radial_lens_stays_one_with_two_focal_lengths(fy: float) -> None:
    """COLMAP holds it as OPENCV then, whose first coefficient could not be open."""
    K = np.array([700.0, fy, 399.5, 299.5])
    camera = Camera(K, (800, 600), Distortion(RADIAL, (-0.1, 0.02)), lens_std=0.1)
    start = start_camera(colmap_camera(camera, "door"))
    assert start.distortion == camera.distortion
    np.testing.assert_allclose(start.K, camera.K)
    assert bundle_camera(start, camera).basis.shape[1] == 2
