"""The verdict of matches that exist."""

from __future__ import annotations

from collections.abc import Iterable
from pathlib import Path
from typing import Any

from dgc_pose.batch.options import BatchOptions
from dgc_pose.batch.pairs import BAD_INPUT, PairRow
from dgc_pose.batch.run import run_batch
from dgc_pose.batch.source import given_source
from dgc_pose.cameras.by_image import Calibration
from dgc_pose.cameras.calibration import read_calibration
from dgc_pose.cameras.camera import Camera, matrix_camera
from dgc_pose.errors import InputError
from dgc_pose.estimation import EstimationOptions
from dgc_pose.matchers import MatcherOptions
from dgc_pose.system.files import scratch_folder


def judge(
    source: str | Path,
    K: Any = None,
    *,
    images: str | Path | None = None,
    options: EstimationOptions | None = None,
    workers: int = 1,
) -> list[PairRow]:
    """The poses of matches that exist, by which to tell right matches from wrong ones.

    source: a COLMAP database, a folder with hloc's features and matches, or a folder of .npz, see
    `dgc-pose judge`. K: of all images, as in `estimate_relative_pose`; None takes the database's
    cameras of known focal length, and estimates the others. images: folder of the photographs; what
    surrounds the matches is then compared too. workers: processes; with more than one, the caller
    must be importable, as for `multiprocessing`.

    Returns a row for each pair, those in doubt first (`by_doubt`). `pose` of a row is as from
    `estimate_pose`, in pixels as the source states them, without `evidence` and `hypotheses`;
    `pose.inliers` are over the matches in the source's order. `rejected`: whether the other pairs
    contradict the pose.

    Raises InputError if the source is unusable or if every pair is; ImageError if a photograph is
    needed and cannot be read. One unusable pair has the status "bad_input".
    """
    given = given_source(Path(source), None if images is None else Path(images))
    if K is None or isinstance(K, str | Path):
        calibration = read_calibration(None if K is None else str(K))
    else:
        camera = K if isinstance(K, Camera) else matrix_camera(K)
        calibration = Calibration("K", common=camera)
    with scratch_folder() as folder:
        batch = run_batch(
            given,
            calibration,
            None,
            folder / "batch",
            matcher=MatcherOptions(),
            estimation=options or EstimationOptions(),
            options=BatchOptions(workers=workers),
        )
        require_judged(batch.rows)
        return by_doubt(pair.row for pair in batch.pairs())


def require_judged(rows: Iterable[PairRow]) -> None:
    """Raise InputError, with the first reason, if no pair can be judged."""
    every = list(rows)
    if all(row.status == BAD_INPUT for row in every):
        first = every[0]
        raise InputError(f"no pair can be judged ({' '.join(first.names)}: {first.reason})")


def by_doubt(rows: Iterable[PairRow]) -> list[PairRow]:
    """The claimed poses that the other pairs do not reject, the least probable first; then all
    other pairs. With equal probabilities, fewer inliers come first."""

    def doubt(row: PairRow) -> tuple[bool, float, int]:
        probability = row.folder_probability if row.probability is None else row.probability
        is_claimed = row.success and not row.rejected
        return not is_claimed, probability or 0.0, row.num_inliers

    return sorted(rows, key=doubt)
