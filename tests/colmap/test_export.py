"""What the export takes from a batch: the matches of each pair, and the cameras that they fit."""

from pathlib import Path
from types import SimpleNamespace
from typing import Any

import numpy as np
import PIL.Image
import pycolmap
import pytest
from scenes import camera_scene, pinhole

from dgc_pose.batch.plan import Plan
from dgc_pose.batch.poses import epipolar_error_px
from dgc_pose.batch.result import Batch
from dgc_pose.batch.rows import MatchedPair, row_of
from dgc_pose.batch.store import open_store
from dgc_pose.batch.work import Job, Worker
from dgc_pose.cameras.camera import Camera
from dgc_pose.cameras.colmap_camera import RADIAL, Distortion
from dgc_pose.colmap.export import pair_geometries, share, write_shared
from dgc_pose.colmap.shared import PairGeometry, SharedMatches
from dgc_pose.estimation import EstimationOptions, RelativePose
from dgc_pose.matchers import MatcherOptions


def test_matches_are_measured_by_the_cameras_that_their_pair_fitted(tmp_path: Path) -> None:
    """Not by those of the folder, whose focal lengths and lenses are still unknown."""
    names = ("a.png", "b.png")
    scene = camera_scene(
        pinhole(1000.0, (1200, 800)), pinhole(1500.0, (1200, 900), Distortion(RADIAL, (0.08, -0.1)))
    )
    first, second = scene.auto()
    cameras = dict(zip(names, (first, second), strict=True))
    count = len(scene.matches)
    alone = RelativePose("ok", "", np.zeros(count, bool), count)
    job = Job(tmp_path, cameras, {}, MatcherOptions("sift"), EstimationOptions(), 2**20)
    matched = [MatchedPair(row_of(names, alone, 0.5), scene.matches)]
    (fitted,) = Worker(job).estimate(matched, cameras, fit_cameras=True)
    plan = Plan(tmp_path, cameras, {}, {}, names, np.array([[0, 1]]), {})
    with open_store(tmp_path, create=True) as store:
        store.begin(plan)
        for table in ("matched", "result"):
            store.add(table, [fitted])  # type: ignore[arg-type]
    (pair,) = pair_geometries(Batch(tmp_path, plan, [fitted.row], {}))
    focals = [camera.focal for camera in pair.cameras]
    assert fitted.row.pose is not None
    np.testing.assert_allclose(focals, [c.focal for c in fitted.row.fitted_cameras])
    assert len(pair.points1) > 0.7 * count
    assert epipolar_error_px(pair.row, pair.cameras, pair.points1, pair.points2).max() < 3
    points = pair.points1, pair.points2
    assert np.median(epipolar_error_px(pair.row, (first, second), *points)) > 3


@pytest.mark.parametrize("orientation", [1, 3, 6, 8])
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
    pair = PairGeometry(row, (cameras["a.jpg"], cameras["b.jpg"]), *seen, np.ones(9))
    matches = np.arange(9, dtype=np.uint32).repeat(2).reshape(9, 2)
    monkeypatch.setattr("dgc_pose.colmap.export.pair_geometries", lambda batch: [pair])
    upright = SharedMatches(dict(zip(names, seen, strict=True)), {names: matches})
    monkeypatch.setattr("dgc_pose.colmap.export.track_corners", lambda *_: upright)
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
