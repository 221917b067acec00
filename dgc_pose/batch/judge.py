"""The verdict of matches that exist."""

from __future__ import annotations

from collections.abc import Iterable, Mapping
from dataclasses import replace
from pathlib import Path
from typing import Any

from dgc_pose.batch.given import read_given
from dgc_pose.batch.given.matches import HeldMatches
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
from dgc_pose.matches import Matches
from dgc_pose.system.files import scratch_folder
from dgc_pose.system.options import check_type


def judge(
    source: str | Path | Mapping[tuple[str, str], Matches],
    K: Any = None,
    *,
    images: str | Path | None = None,
    options: EstimationOptions | None = None,
    workers: int = 1,
) -> list[PairRow]:
    """The poses of matches that exist, and how likely each is right.

    source: matches by the names of their images; or a path, see `dgc-pose judge`: a COLMAP
    database, a folder with hloc's features and matches, or a folder of .npz. K: of all images, as
    in `estimate_relative_pose`, or `Camera`s by name; None takes the cameras of known focal length
    of a database, and estimates all others. images: folder of the photographs; what surrounds the
    matches is then compared too. workers: processes, which import the caller's module.

    Returns a row for each pair, in the order of `by_doubt`. `pose` of a row is that of
    `estimate_pose`, without `evidence` and `hypotheses`: x2 = R x1 + t, in pixels as the source has
    them. `pose.inliers` are over the matches in the source's order. `rejected`: whether the other
    pairs contradict the pose. A pair that cannot be judged has the status "bad_input".

    Raises InputError if the source is unusable, if no pair can be judged, or if an argument is of
    the wrong type; OSError if a file cannot be read.
    """
    check_type(options, EstimationOptions | None, "options")
    check_type(images, str | Path | None, "images")
    check_type(source, str | Path | Mapping, "source")
    given = HeldMatches.of(source) if isinstance(source, Mapping) else read_given(Path(source))
    with scratch_folder() as folder:
        batch = run_batch(
            given_source(given, None if images is None else Path(images)),
            _calibration(K),
            None,
            folder / "batch",
            matcher=MatcherOptions(),
            estimation=options or EstimationOptions(),
            options=BatchOptions(workers=workers),
        )
        require_judged(batch.rows)
        return by_doubt(pair.row for pair in batch.pairs())


def _calibration(K: Any) -> Calibration:
    if isinstance(K, Mapping):
        return Calibration("K", by_name=K)
    if K is None or isinstance(K, str | Path):
        return read_calibration(None if K is None else str(K))
    camera = K if isinstance(K, Camera) else matrix_camera(K)
    return Calibration("K", common=replace(camera, identity=camera.identity or "K"))


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
