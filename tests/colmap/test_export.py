"""What the export takes from a batch: the matches of each pair, and the cameras that they fit."""

from pathlib import Path

import numpy as np
from camera_scene import camera_scene, pinhole

from dgc_pose.batch.plan import Plan
from dgc_pose.batch.poses import epipolar_error_px
from dgc_pose.batch.result import Batch
from dgc_pose.batch.rows import MatchedPair, row_of
from dgc_pose.batch.store import open_store
from dgc_pose.batch.work import Job, Worker
from dgc_pose.cameras.colmap_camera import RADIAL, Distortion
from dgc_pose.colmap.export import pair_geometries
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
