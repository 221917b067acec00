"""The figures of each method over all pairs, as data and as a table."""

from collections.abc import Iterable, Sequence
from dataclasses import asdict, dataclass
from typing import Any

import numpy as np

from dgc_pose.benchmarks.files import decimals, finite_data, table
from dgc_pose.benchmarks.scores import MapScore, PoseScore, Score
from dgc_pose.errors import InputError
from dgc_pose.estimation import EstimationOptions
from dgc_pose.estimation.problem import THRESHOLD_FACTOR
from dgc_pose.metrics import pose_auc

_COLUMNS = {
    "method": "{0.method}",
    "pairs": "{0.pairs}",
    "failures": "{0.failures} ({0.failed_percent:.1f} %)",
    "R med": "{0.median_rotation_deg:.2f}",
    "t med": "{0.median_translation_deg:.2f}",
    "t folded": "{0.median_translation_folded_deg:.2f}",
    **{f"AUC@{limit}": f"{{0.auc{limit}:.1f}}" for limit in (5, 10, 20)},
    "s/pair": "{0.seconds_per_pair:.2f}",
}
_EPIPOLAR_COLUMNS = {
    **_COLUMNS,
    "D_e all": "{0.median_epipolar_text}",
    "D_e conf": "{0.median_epipolar_confident_px:.2f}",
    "matches": "{0.matches_per_pair:.0f}",
    "pose s": "{0.pose_seconds_per_pair:.3f}",
}


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

    @property
    def failed_percent(self) -> float:
        return 100 * self.failures / self.pairs


@dataclass(frozen=True)
class EpipolarSummary(MethodSummary):
    """With D_e; the fields are the keys of bench-dtu's summary.json."""

    # Medians over the pairs of the pairs' median D_e, pixels of the images that the methods saw
    median_epipolar_px: float  # over all pixels; NaN without a dense map
    median_epipolar_confident_px: float  # over the matches that the pose is estimated from
    matches_per_pair: float  # mean
    match_seconds_per_pair: float  # mean
    pose_seconds_per_pair: float  # mean

    @property
    def median_epipolar_text(self) -> str:
        return decimals(self.median_epipolar_px, 2)


def by_method(scores: Iterable[Score]) -> dict[str, list[Score]]:
    """The records of each method, in the order in which they come. Raises InputError for none."""
    methods: dict[str, list[Score]] = {}
    for score in scores:
        methods.setdefault(score.method, []).append(score)
    if not methods:
        raise InputError("no results")
    return methods


def columns(scores: Iterable[PoseScore]) -> dict[str, dict[str, np.ndarray]]:
    """The numbers of the records as arrays, by method and field."""
    return {
        method: {
            name: np.array([getattr(row, name) for row in rows], dtype=np.float64)
            for name, value in vars(rows[0]).items()
            if isinstance(value, int | float)
        }
        for method, rows in by_method(scores).items()
    }


def summarise(scores: Sequence[PoseScore]) -> MethodSummary:
    """The figures of one method from its records. Raises InputError for none, or if they are of
    several methods."""
    methods = columns(scores)
    if len(methods) > 1:
        raise InputError(f"results of one method are needed, not of {len(methods)}")
    ((method, column),) = methods.items()
    rotation, translation = column["rotation_error_deg"], column["translation_folded_deg"]
    auc5, auc10, auc20 = pose_auc(np.maximum(rotation, translation), (5, 10, 20))
    return MethodSummary(
        method=method,
        pairs=len(scores),
        failures=sum(not score.success for score in scores),
        median_rotation_deg=float(np.median(rotation)),
        median_translation_deg=float(np.median(column["translation_error_deg"])),
        median_translation_folded_deg=float(np.median(translation)),
        auc5=auc5,
        auc10=auc10,
        auc20=auc20,
        seconds_per_pair=float(np.mean(column["match_seconds"] + column["estimate_seconds"])),
    )


def summarise_epipolar(scores: Sequence[MapScore]) -> EpipolarSummary:
    """As `summarise`, with D_e and the parts of the time."""
    summary = summarise(scores)
    column = columns(scores)[summary.method]
    return EpipolarSummary(
        **asdict(summary),
        median_epipolar_px=float(np.median(column["epipolar_all_px"])),
        median_epipolar_confident_px=float(np.median(column["epipolar_confident_px"])),
        matches_per_pair=float(np.mean(column["num_matches"])),
        match_seconds_per_pair=float(np.mean(column["match_seconds"])),
        pose_seconds_per_pair=float(np.mean(column["estimate_seconds"])),
    )


def summary_data(summaries: Sequence[MethodSummary]) -> dict[str, Any]:
    """The summary for JSON, with null for a figure that is infinite or NaN."""
    return {"methods": [finite_data(asdict(summary)) for summary in summaries]}


def heading(options: EstimationOptions) -> str:
    """What the table's columns mean, and the estimator that all methods went through."""
    threshold = f"{THRESHOLD_FACTOR:g} x the matcher's error"
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
    """The summaries, all of one class, as a table; angles in degrees, AUC in percent."""
    epipolar = isinstance(summaries[0], EpipolarSummary)
    return table(_EPIPOLAR_COLUMNS if epipolar else _COLUMNS, summaries)
