"""The rows of a folder beside those of each pair by itself."""

from dataclasses import replace

import numpy as np

from dgc_pose.batch.pooling import fit_of
from dgc_pose.batch.poses import compared
from dgc_pose.batch.rows import MatchedPair, PairRow
from dgc_pose.cameras.camera import Camera
from dgc_pose.estimation import RelativePose


def _row(first, second, status="ok", inliers=9):
    posed = {"R": np.eye(3), "t": np.array([0.0, 0, 1])} if status == "ok" else {}
    kept = np.arange(10) < inliers
    pose = RelativePose(status, "", kept, 10, **posed)
    return PairRow(first, second, status, "", pose)


def _compared(alone, rows):
    return [pair.row for pair in compared(map(MatchedPair, rows), alone)]


def test_a_photograph_that_most_pairs_show_as_mirrored_has_no_pose_with_others():
    """m: mirrored in two pairs of three. The others have more poses."""
    alone = [
        _row("a", "m", "mirrored", 0),
        _row("b", "m", "mirrored", 0),
        _row("c", "m"),
        *(_row(*pair) for pair in ("ab", "ac", "bc")),
    ]
    results = _compared(alone, alone)
    assert [row.status for row in results] == ["mirrored"] * 3 + ["ok"] * 3
    told = results[2]
    assert told.pose is not None and told.pose.R is None and "m" in told.reason
    assert (told.num_matches, told.num_inliers, results[3].num_inliers) == (10, 0, 9)


def test_photographs_that_are_all_mirrored_keep_the_poses_between_them():
    rows = [_row("a", "c", "mirrored", 0), _row("a", "d", "mirrored", 0), _row("c", "d")]
    rows += [_row("b", "c", "mirrored", 0), _row("b", "d", "mirrored", 0), _row("a", "b")]
    assert _compared(rows, rows) == rows


def test_inliers_that_the_cameras_of_the_folder_lose_are_told():
    alone = [_row("a", "b"), _row("b", "c"), _row("c", "d", "improbable")]
    rows = [_row("a", "b", inliers=4), _row("b", "c", inliers=5), _row("c", "d", inliers=1)]
    lost, kept, refused = _compared(alone, rows)
    assert lost.pose is not None
    assert lost.pose.warnings == ("the folder's cameras leave 4 of 9 inliers",)
    assert kept == rows[1] and refused == rows[2]


def test_a_pair_without_a_pose_or_of_another_camera_model_fits_no_camera():
    rows = [_row("a", "b"), _row("a", "c", "improbable"), _row("b", "c")]
    fitted = {"camera1": Camera(np.eye(3)), "camera2": Camera(np.eye(3))}
    for k, row in enumerate(rows):
        assert row.pose is not None and row.fitted_cameras is None
        pose = replace(row.pose, camera_covariance=np.eye(12), **fitted)
        rows[k] = replace(row, pose=pose)
    rows[2] = replace(rows[2], camera_model="squeezed")
    assert all(row.fitted_cameras is not None for row in rows)
    assert [fit_of(row) is not None for row in rows] == [True, False, False]
