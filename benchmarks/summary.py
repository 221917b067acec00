"""The figures of each method over all pairs, as data and as a table."""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from dataclasses import asdict, dataclass
from typing import Any

import numpy as np

from dgc_pose.benchmarks.scores import MapScore, PoseScore, Score
from dgc_pose.benchmarks.table import aligned
from dgc_pose.errors import InputError
from dgc_pose.estimation import EstimationOptions
from dgc_pose.files.json_files import finite_or_none
from dgc_pose.metrics import pose_auc

COLUMNS = (
    *("method", "pairs", "failures", "R med", "t med", "t folded"),
    *("AUC@5", "AUC@10", "AUC@20", "s/pair"),
)
MAP_COLUMNS = (*COLUMNS, "D_e all", "D_e conf", "matches", "pose s")


@dataclass(frozen=True)
class MethodSummary:
    """One method over all pairs; the fields are the keys of bench-pairs' JSON."""

    method: str
    pairs: int
    failures: int  # pairs without a pose
    median_rotation_deg: float  # over all pairs, a failure as infinite; so are the next two
    median_translation_deg: float
    median_translation_folded_deg: float
    auc5: float  # percent; of max(rotation, folded translation), a failure as infinite
    auc10: float
    auc20: float
    seconds_per_pair: float  # mean time to match and estimate, without reading the images


@dataclass(frozen=True)
class MapSummary(MethodSummary):
    """With D_e; the fields are the keys of bench-dtu's summary.json."""

    # Medians over the pairs of the pairs' median D_e, pixels of the images that the methods saw
    median_epipolar_px: float  # over all pixels; NaN without a dense map
    median_epipolar_confident_px: float  # over the matches that the pose is estimated from
    matches_per_pair: float  # mean
    match_seconds_per_pair: float  # mean
    pose_seconds_per_pair: float  # mean


def by_method(scores: Iterable[Score]) -> dict[str, list[Score]]:
    """The records of each method, in the order in which they come. Raises InputError for none."""
    found: dict[str, list[Score]] = {}
    for score in scores:
        found.setdefault(score.method, []).append(score)
    if not found:
        raise InputError("no results")
    return found


def columns(scores: Iterable[PoseScore]) -> dict[str, dict[str, np.ndarray]]:
    """The numbers of the records as arrays, by method and field."""
    return {
        method: {
            name: np.array([getattr(one, name) for one in own], dtype=np.float64)
            for name, value in vars(own[0]).items()
            if isinstance(value, float)
        }
        for method, own in by_method(scores).items()
    }


def summarise(scores: Sequence[PoseScore]) -> MethodSummary:
    """The figures of one method from its records. Raises InputError for none, or if they are of
    several methods."""
    (method, *others) = by_method(scores)
    if others:
        raise InputError(f"results of one method are needed, not of {1 + len(others)}")
    translation = _column(scores, "translation_folded_deg")
    rotation = _column(scores, "rotation_error_deg")
    auc5, auc10, auc20 = pose_auc(np.maximum(rotation, translation), (5, 10, 20))
    seconds = [score.match_seconds + score.estimate_seconds for score in scores]
    return MethodSummary(
        method=method,
        pairs=len(scores),
        failures=sum(not score.success for score in scores),
        median_rotation_deg=float(np.median(rotation)),
        median_translation_deg=float(np.median(_column(scores, "translation_error_deg"))),
        median_translation_folded_deg=float(np.median(translation)),
        auc5=auc5,
        auc10=auc10,
        auc20=auc20,
        seconds_per_pair=float(np.mean(seconds)),
    )


def summarise_maps(scores: Sequence[MapScore]) -> MapSummary:
    """As `summarise`, with D_e and the parts of the time."""
    return MapSummary(
        **asdict(summarise(scores)),
        median_epipolar_px=float(np.median(_column(scores, "epipolar_all_px"))),
        median_epipolar_confident_px=float(np.median(_column(scores, "epipolar_confident_px"))),
        matches_per_pair=float(np.mean(_column(scores, "num_matches"))),
        match_seconds_per_pair=float(np.mean(_column(scores, "match_seconds"))),
        pose_seconds_per_pair=float(np.mean(_column(scores, "estimate_seconds"))),
    )


def summary_data(summaries: Sequence[MethodSummary]) -> dict[str, Any]:
    """The summary for JSON, with null for a figure that is infinite or NaN."""
    return {"methods": [_json_values(summary) for summary in summaries]}


def heading(options: EstimationOptions) -> str:
    """What the table's columns mean, and the estimator that all methods went through."""
    threshold = f"{options.threshold_factor:g} x the matcher's error"
    if options.threshold_px is not None:
        threshold = f"{options.threshold_px:g} px"
    return (
        f"estimator poselib, {options.runs} runs of {options.iterations} iterations, "
        f"threshold {threshold}, seed {options.seed}\n"
        "medians in degrees over all pairs, a failure counted as infinite; t: 0 to 180, "
        "t folded: min(e, 180 - e)\n"
        "AUC in percent, of max(R, t folded); s/pair: matching and estimating"
    )


def summary_table(summaries: Sequence[MethodSummary]) -> str:
    """The summary as a table; angles in degrees, AUC in percent."""
    return aligned([COLUMNS, *(_cells(summary) for summary in summaries)])


def map_table(summaries: Sequence[MapSummary]) -> str:
    """As `summary_table`, with D_e, the number of matches and the pose stage's time."""
    rows = [
        (
            *_cells(one),
            "-" if np.isnan(one.median_epipolar_px) else f"{one.median_epipolar_px:.2f}",
            f"{one.median_epipolar_confident_px:.2f}",
            f"{one.matches_per_pair:.0f}",
            f"{one.pose_seconds_per_pair:.3f}",
        )
        for one in summaries
    ]
    return aligned([MAP_COLUMNS, *rows])


def _cells(summary: MethodSummary) -> tuple[str, ...]:
    share = 100 * summary.failures / summary.pairs
    angles = (
        summary.median_rotation_deg,
        summary.median_translation_deg,
        summary.median_translation_folded_deg,
    )
    return (
        summary.method,
        str(summary.pairs),
        f"{summary.failures} ({share:.1f} %)",
        *(f"{angle:.2f}" for angle in angles),
        *(f"{auc:.1f}" for auc in (summary.auc5, summary.auc10, summary.auc20)),
        f"{summary.seconds_per_pair:.2f}",
    )


def _json_values(summary: MethodSummary) -> dict[str, Any]:
    values = asdict(summary).items()
    return {k: finite_or_none(v) if isinstance(v, float) else v for k, v in values}


def _column(scores: Sequence[PoseScore], field: str) -> np.ndarray:
    return np.array([getattr(score, field) for score in scores])
