"""What the export takes from a batch: the matches of each pair, and the cameras that they fit."""

from pathlib import Path

import numpy as np
from camera_scene import camera_scene, pinhole

from dgc_pose.batch.matches_file import PairMatches, PoseInputs
from dgc_pose.batch.plan import Plan
from dgc_pose.batch.poses import epipolar_error_px
from dgc_pose.batch.result import Batch, write_pairs
from dgc_pose.batch.rows import PairRow
from dgc_pose.batch.work import Estimate, Job, Matched, Worker
from dgc_pose.cameras.colmap_camera import RADIAL, Distortion
from dgc_pose.colmap.export import pair_geometries
from dgc_pose.estimation import EstimationOptions
from dgc_pose.matchers import MatcherOptions


def test_matches_are_measured_by_the_cameras_that_their_pair_fitted(tmp_path: Path) -> None:
    """Not by those of the folder, whose focal lengths and lenses are still unknown."""
    names = ("a.png", "b.png")
    scene = camera_scene(
        pinhole(1000.0, (1200, 800)), pinhole(1500.0, (1200, 900), Distortion(RADIAL, (0.08, -0.1)))
    )
    first, second = scene.auto()
    cameras = dict(zip(names, (first, second), strict=True))
    arrays = (scene.matches.points1, scene.matches.points2, scene.matches.confidence)
    points1, points2, scores = (array.astype(np.float32) for array in arrays)
    inputs = PoseInputs(0.5, False, None)
    stored = PairMatches(points1, points2, scores, np.zeros(len(scores), bool), inputs)
    alone = Matched((0,), [PairRow(*names, "ok", True, "")], [stored], {})
    job = Job(tmp_path, cameras, {}, MatcherOptions("sift"), EstimationOptions(), 2**20)
    fitted = Worker(job).do(Estimate(alone, cameras, True))
    assert isinstance(fitted, Matched)
    rows = write_pairs(tmp_path, [fitted], 0)
    plan = Plan(tmp_path, cameras, {}, {}, names, np.array([[0, 1]]), {})
    (pair,) = pair_geometries(Batch(tmp_path, plan, rows, {}))
    focals = [camera.focal for camera in pair.cameras]
    np.testing.assert_allclose(focals, (rows[0].focal1, rows[0].focal2))
    assert len(pair.points1) > 0.7 * len(scores)
    assert epipolar_error_px(pair.row, pair.cameras, pair.points1, pair.points2).max() < 3
    points = pair.points1, pair.points2
    assert np.median(epipolar_error_px(pair.row, (first, second), *points)) > 3
