"""The rows of a folder beside those of each pair by itself."""

from dataclasses import replace

import numpy as np

from dgc_pose.batch.matches_file import NO_MATCHES, FittedCameras
from dgc_pose.batch.poses import compared, fitted_pairs
from dgc_pose.batch.rows import PairRow
from dgc_pose.batch.work import Matched
from dgc_pose.cameras.camera import Camera


def _row(first: str, second: str, status: str = "ok", inliers: int = 9) -> PairRow:
    posed = status == "ok"
    pose = {"R": tuple(np.eye(3).ravel().tolist()), "t": (0.0, 0.0, 1.0)} if posed else {}
    return PairRow(
        first,
        second,
        status,
        posed,
        "",
        num_matches=10,
        num_inliers=inliers,
        **pose,  # type: ignore[arg-type]
    )


def _compared(alone: list[PairRow], rows: list[PairRow]) -> list[tuple[PairRow, int]]:
    """The rows, and how many inliers their matches have."""
    points = np.zeros((10, 2), np.float32)
    inliers = [np.arange(10) < row.num_inliers for row in rows]
    matches = [
        replace(NO_MATCHES, points1=points, points2=points, scores=points[:, 0], inliers=chosen)
        for chosen in inliers
    ]
    (block,) = compared([Matched(tuple(range(len(rows))), rows, matches, {})], alone)
    counts = [int(of_pair.inliers.sum()) for of_pair in block.matches]
    return list(zip(block.rows, counts, strict=True))


def test_a_photograph_that_most_pairs_show_as_mirrored_has_no_pose_with_others() -> None:
    """m: mirrored in two pairs of three. The others have more poses."""
    alone = [
        _row("a", "m", "mirrored", 0),
        _row("b", "m", "mirrored", 0),
        _row("c", "m"),
        *(_row(*pair) for pair in ("ab", "ac", "bc")),
    ]
    results = _compared(alone, alone)
    assert [row.status for row, _ in results] == ["mirrored"] * 3 + ["ok"] * 3
    told, inliers = results[2]
    assert told.R is None and told.t is None and not told.success and "m" in told.reason
    assert (told.num_matches, inliers) == (10, 0) and results[3][1] == 9


def test_photographs_that_are_all_mirrored_keep_the_poses_between_them() -> None:
    rows = [_row("a", "c", "mirrored", 0), _row("a", "d", "mirrored", 0), _row("c", "d")]
    rows += [_row("b", "c", "mirrored", 0), _row("b", "d", "mirrored", 0), _row("a", "b")]
    assert [row for row, _ in _compared(rows, rows)] == rows


def test_inliers_that_the_cameras_of_the_folder_lose_are_told() -> None:
    alone = [_row("a", "b"), _row("b", "c"), _row("c", "d", "improbable")]
    rows = [_row("a", "b", inliers=4), _row("b", "c", inliers=5), _row("c", "d", inliers=1)]
    (lost, _), (kept, _), (refused, _) = _compared(alone, rows)
    assert lost.warnings == ("the folder's cameras leave 4 of 9 inliers",)
    assert kept == rows[1] and refused == rows[2]


def test_a_pair_without_a_pose_or_of_another_camera_model_fits_no_camera() -> None:
    camera = Camera(np.eye(3))
    matches = replace(NO_MATCHES, fitted=FittedCameras((camera, camera), np.eye(12)))
    rows = [_row("a", "b"), _row("a", "c", "improbable")]
    rows.append(replace(_row("b", "c"), camera_model="squeezed"))
    later, first = (
        Matched((2,), rows[2:], [matches], {}),
        Matched((0, 1), rows[:2], [matches] * 2, {}),
    )
    pairs = fitted_pairs([later, first])
    assert [pair.row for pair in pairs] == rows
    assert [pair.fitted is not None for pair in pairs] == [True, False, False]
