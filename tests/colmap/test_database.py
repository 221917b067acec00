"""The COLMAP database: the half-pixel offset, cameras, geometries, and what is refused."""

from dataclasses import replace
from pathlib import Path
from types import SimpleNamespace
from typing import Any

import numpy as np
import PIL.Image
import pycolmap
import pytest
from results import camera, pair_row
from scipy.spatial.transform import Rotation

from dgc_pose.batch.pairs import MatchedPair, row_of
from dgc_pose.cameras.camera import Camera
from dgc_pose.colmap.database import (
    pair_geometries,
    share,
    two_view_geometry,
    write_database,
    write_shared,
)
from dgc_pose.colmap.tracking import PairGeometry, SharedMatches
from dgc_pose.errors import InputError
from dgc_pose.estimation import RelativePose, Status
from dgc_pose.geometry.epipolar import essential_from_pose
from dgc_pose.matches import Matches

NAMES = ("b.png", "a.png")
INDEX = np.array([[0, 1], [2, 0]], np.uint32)


def _write(path: Path) -> tuple[np.ndarray, np.ndarray]:
    R = Rotation.from_rotvec([0.2, -0.4, 0.1]).as_matrix()
    t = np.array([0.6, 0.0, 0.8])
    points = np.array([[0.0, 0], [10.25, 7], [3, 4]]), np.array([[5.0, 6], [7, 8]])
    shared = SharedMatches(dict(zip(NAMES, points, strict=True)), {NAMES: INDEX})
    row = pair_row(NAMES, "ok", R, t, count=100)
    cameras = {name: camera() for name in NAMES}
    cameras["c.png"] = replace(camera(), focal_std=0.4)
    names = ("a.png", "b.png", "c.png", "bad.png")
    write_database(path, names, cameras, shared, [row])
    return R, t


def test_key_points_matches_and_geometry(tmp_path: Path) -> None:
    """The centre of the top-left pixel, our (0, 0), is COLMAP's (0.5, 0.5). b.png has the larger
    id: COLMAP stores the pair the other way round, and inverts the pose."""
    path = tmp_path / "database.db"
    R, t = _write(path)
    with pycolmap.Database.open(path) as database:
        b, a = (database.read_image_with_name(name).image_id for name in NAMES)
        assert a < b
        points, stored = (
            database.read_keypoints(b)[:, :2],
            database.read_camera(database.read_image(b).camera_id),
        )
        matches = database.read_matches(b, a)
        forward = database.read_two_view_geometry(b, a)
        backward = database.read_two_view_geometry(a, b)
        assert database.num_images() == 3
        # The focal length of one camera is known, that of the other a guess.
        priors = [stored.has_prior_focal_length for stored in database.read_all_cameras()]
        assert sorted(priors) == [False, True]
    np.testing.assert_array_equal(points, [[0.5, 0.5], [10.75, 7.5], [3.5, 4.5]])
    # A ray through our pixel is the ray through COLMAP's.
    ours = camera().normalise(np.array([[10.25, 7]]))
    np.testing.assert_allclose(stored.cam_from_img(points[1:2].astype(float)), ours)
    np.testing.assert_array_equal(matches, INDEX)
    np.testing.assert_array_equal(forward.inlier_matches, INDEX)
    assert forward.config == pycolmap.TwoViewGeometryConfiguration.CALIBRATED
    np.testing.assert_allclose(forward.cam2_from_cam1.rotation.matrix(), R, atol=1e-9)
    np.testing.assert_allclose(forward.cam2_from_cam1.translation, t, atol=1e-9)
    np.testing.assert_allclose(backward.cam2_from_cam1.rotation.matrix(), R.T, atol=1e-9)
    np.testing.assert_allclose(forward.E, essential_from_pose(R, t), atol=1e-9)


@pytest.mark.parametrize(
    ("identity", "std", "count"), [("x", 0.01, 1), (None, 0.01, 2), (None, 0, 1)]
)
def test_images_of_one_camera_share_it(
    tmp_path: Path, identity: str | None, std: float, count: int
) -> None:
    """Those that have a focal length of their own, not known, do not, though it is the same."""
    K = np.array([[110.0, 0, 49.5], [0, 110, 39.5], [0, 0, 1]])
    one = Camera(K, (100, 80), focal_std=std, lens_std=std, identity=identity)
    cameras, path = dict.fromkeys(NAMES, one), tmp_path / "database.db"
    write_database(path, NAMES, cameras, SharedMatches({}, {}), ())
    with pycolmap.Database.open(path) as database:
        stored = database.read_all_cameras()
    assert len(stored) == count and all(camera.has_prior_focal_length for camera in stored)
    # The lens of a camera that is not known may be one with distortion.
    expected = ("RADIAL", [110, 50, 40, 0, 0]) if std else ("PINHOLE", [110, 110, 50, 40])
    assert (stored[0].model.name, stored[0].params.tolist()) == expected


@pytest.mark.parametrize(
    ("status", "config"),
    [("ok", "CALIBRATED"), ("planar", "PLANAR"), ("rotation_only", "PANORAMIC")],
)
def test_the_status_is_the_configuration(status: Status, config: str) -> None:
    row = pair_row(NAMES, status)
    geometry = two_view_geometry(row, INDEX)
    assert geometry.config == getattr(pycolmap.TwoViewGeometryConfiguration, config)
    assert (geometry.E is None) == (status == "rotation_only")


def test_a_failed_write_leaves_the_old_file(tmp_path: Path) -> None:
    path = tmp_path / "database.db"
    _write(path)
    before = path.read_bytes()
    skewed = Camera(camera().K + np.eye(3, k=1) * (0, 1, 0), camera().size)
    with pytest.raises(InputError, match="a: K has a skew"):
        write_database(path, ["a"], {"a": skewed}, SharedMatches({}, {}), ())
    assert path.read_bytes() == before
    assert list(tmp_path.iterdir()) == [path]


def test_matches_are_measured_by_the_cameras_that_their_pair_fitted() -> None:
    """Not by those of the folder, whose focal lengths are still unknown; but by these where the
    pair fitted none."""
    prior = replace(camera(), focal_std=0.4)
    fitted = tuple(prior.with_focal(factor * prior.focal) for factor in (1.2, 1.3))
    t, matches = np.array([1.0, 0, 0]), Matches(np.zeros((9, 2)), np.zeros((9, 2)), np.ones(9), 1.0)
    pose = RelativePose(
        *("ok", "", np.arange(9) < 7, 9, np.eye(3), t),
        camera1=fitted[0],
        camera2=fitted[1],
        camera_covariance=np.eye(12),
    )
    poses = pose, replace(pose, camera_covariance=None)
    pairs = [MatchedPair(row_of(NAMES, pose, 0.5), matches) for pose in poses]
    plan = SimpleNamespace(final_cameras=dict.fromkeys(NAMES, prior))
    batch: Any = SimpleNamespace(plan=plan, pairs=lambda: iter(pairs))
    by_pair, by_folder = pair_geometries(batch)
    assert by_pair.cameras == fitted and by_folder.cameras == (prior, prior)
    assert len(by_pair.matches) == 7


@pytest.mark.parametrize("orientation", [1, 6])
def test_a_database_is_of_the_pixels_as_stored(
    tmp_path: Path, orientation: int, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Of an upright image that its EXIF orientation has turned: where the points of the world are
    in the file, for its camera and its pose."""
    exif = PIL.Image.Exif()
    exif[0x0112] = orientation
    names, stored = ("a.jpg", "b.jpg"), PIL.Image.new("L", (64, 48))
    stored.save(tmp_path / "a.jpg")
    stored.save(tmp_path / "b.jpg", exif=exif)
    size = (64, 48) if orientation < 5 else (48, 64)
    cameras = {
        "a.jpg": Camera(np.array([50.0, 52, 33, 23]), (64, 48)),
        "b.jpg": Camera(np.array([50.0, 52, 25, 30]), size),
    }
    points = np.random.default_rng(0).uniform(-1, 1, (9, 3)) + (0, 0, 5)
    t = np.array([0.6, 0, 0.8])
    moved = points + t
    seen = [
        cameras[n].project(x[:, :2] / x[:, 2:]) for n, x in zip(names, (points, moved), strict=True)
    ]
    row = row_of(names, RelativePose("ok", "", np.ones(9, bool), 9, np.eye(3), t), 1.0)
    pair = PairGeometry(row, (cameras["a.jpg"], cameras["b.jpg"]), Matches(*seen, np.ones(9), 1.0))
    matches = np.arange(9, dtype=np.uint32).repeat(2).reshape(9, 2)
    monkeypatch.setattr("dgc_pose.colmap.database.pair_geometries", lambda batch: [pair])
    upright = SharedMatches(dict(zip(names, seen, strict=True)), {names: matches})
    monkeypatch.setattr("dgc_pose.colmap.database.track_corners", lambda *_: upright)
    plan = SimpleNamespace(names=names, final_cameras=cameras, root=tmp_path, settings={})
    batch: Any = SimpleNamespace(plan=plan, rows=[row])
    write_shared(batch, share(batch, 100), tmp_path / "d.db")
    with pycolmap.Database.open(tmp_path / "d.db") as database:
        image = database.read_image_with_name("b.jpg")
        camera = database.read_camera(image.camera_id)
        id1 = database.read_image_with_name("a.jpg").image_id
        pose = database.read_two_view_geometry(id1, image.image_id).cam2_from_cam1
        key_points = database.read_keypoints(image.image_id)[:, :2]
    assert (camera.width, camera.height) == (64, 48)
    in_file = camera.img_from_cam(pose * points)
    np.testing.assert_allclose(key_points, in_file, atol=1e-4)
