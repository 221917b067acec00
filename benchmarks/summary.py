"""The figures of each method over all pairs, as data and as a table."""

from collections.abc import Iterable, Mapping, Sequence
from dataclasses import asdict, dataclass
from typing import Any

import numpy as np

from dgc_pose.benchmarks.files import decimals, finite_data, table
from dgc_pose.benchmarks.metrics import pose_auc
from dgc_pose.benchmarks.reliability import Reliability
from dgc_pose.benchmarks.scores import CameraScore, MapScore, PoseScore, Score
from dgc_pose.errors import InputError
from dgc_pose.estimation import EstimationOptions
from dgc_pose.estimation.probability import RIGHT_DEG
from dgc_pose.estimation.problem import THRESHOLD_FACTOR
from dgc_pose.files.tables import aligned

Column = Mapping[str, np.ndarray]  # numbers of one method's records, by field

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
_SURE_STD = 0.05  # of ln f: focal lengths of a smaller deviation are sure
_CAMERA_HEADING = (
    "poses claimed, and wrong ones among them (over 10 degrees in R or t); doubted: the pose says "
    "that a K may be wrong;\n"
    "told: doubted, or no pose; p off: calibration error of the probability, points; in 90 %: "
    "share of right poses whose\n"
    "error is within the expected one; f: focal lengths of claimed poses, median error and share "
    "within two deviations,\n"
    "of all and of those with a deviation below 5 %; shares and errors in percent"
)
_CAMERA_COLUMNS = {  # field and decimals
    "claimed": ("claimed", 0),
    "wrong": ("wrong", 0),
    "doubted": ("doubted", 0),
    "told": ("told_percent", 1),
    "p off": ("probability_error_percent", 1),
    "R in 90 %": ("rotation_within_percent", 0),
    "t in 90 %": ("translation_within_percent", 0),
    "f error": ("median_focal_error_percent", 2),
    "in 2 std": ("focal_within_percent", 0),
    "std < 5 %": ("sure_percent", 0),
    "their f error": ("sure_median_focal_error_percent", 2),
    "their in 2 std": ("sure_focal_within_percent", 0),
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


@dataclass(frozen=True)
class CameraSummary(MethodSummary):
    """With the focal lengths, and whether the claims hold; NaN for a share of nothing."""

    claimed: int  # poses
    wrong: int  # of them, over 10 degrees off in R or t (0 to 180)
    doubted: int  # of all pairs: by the pose a K may be wrong
    told_percent: float  # doubted, or without a pose
    probability_error_percent: float  # expected calibration error, over the pairs that have one
    # Of the right poses that expect an error: whether that of R, of t, is within
    rotation_within_percent: float
    translation_within_percent: float
    # Of the focal lengths of all claimed poses, two a pair; sure: those with a deviation below
    # `_SURE_STD`
    median_focal_error_percent: float
    focal_within_percent: float  # error within two deviations, of those that have a deviation
    sure_percent: float
    sure_median_focal_error_percent: float
    sure_focal_within_percent: float


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
    """The figures of one method from its records, those of D_e or of the cameras too if the records
    have them. Raises InputError for none, or if they are of several methods."""
    methods = columns(scores)
    if len(methods) > 1:
        raise InputError(f"results of one method are needed, not of {len(methods)}")
    ((method, column),) = methods.items()
    rotation, translation = column["rotation_error_deg"], column["translation_folded_deg"]
    auc5, auc10, auc20 = pose_auc(np.maximum(rotation, translation), (5, 10, 20))
    summary = MethodSummary(
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
    if isinstance(scores[0], MapScore):
        return _with_distances(summary, column)
    return _with_cameras(summary, column) if isinstance(scores[0], CameraScore) else summary


def _with_distances(summary: MethodSummary, column: Column) -> EpipolarSummary:
    return EpipolarSummary(
        **asdict(summary),
        median_epipolar_px=float(np.median(column["epipolar_all_px"])),
        median_epipolar_confident_px=float(np.median(column["epipolar_confident_px"])),
        matches_per_pair=float(np.mean(column["num_matches"])),
        match_seconds_per_pair=float(np.mean(column["match_seconds"])),
        pose_seconds_per_pair=float(np.mean(column["estimate_seconds"])),
    )


def _with_cameras(summary: MethodSummary, column: Column) -> CameraSummary:
    claimed, doubted = (column[name] > 0 for name in ("success", "doubts_camera"))
    rotation, translation = column["rotation_error_deg"], column["translation_error_deg"]
    right = claimed & (np.maximum(rotation, translation) <= RIGHT_DEG)
    expected = right & np.isfinite(column["rotation_90_deg"])
    probability = column["probability"]
    if not np.isfinite(probability[claimed]).any():  # that of a pair without a pose is 0
        probability = np.full(summary.pairs, np.nan)
    probable = np.isfinite(probability)
    error, std = (
        np.concatenate([column[f"focal{n}_{name}"][claimed] for n in (1, 2)])
        for name in ("error", "std")
    )
    fitted, sure = std > 0, (std > 0) & (std < _SURE_STD)
    within = np.abs(error) <= 2 * std
    return CameraSummary(
        **asdict(summary),
        claimed=int(claimed.sum()),
        wrong=int((claimed & ~right).sum()),
        doubted=int(doubted.sum()),
        told_percent=_share(doubted | ~claimed),
        probability_error_percent=100
        * Reliability.of(probability[probable], right[probable]).calibration_error,
        rotation_within_percent=_share((rotation <= column["rotation_90_deg"])[expected]),
        translation_within_percent=_share((translation <= column["translation_90_deg"])[expected]),
        median_focal_error_percent=_median_percent(error),
        focal_within_percent=_share(within[fitted]),
        sure_percent=_share(sure),
        sure_median_focal_error_percent=_median_percent(error[sure]),
        sure_focal_within_percent=_share(within[sure]),
    )


def _share(true: np.ndarray) -> float:
    return 100 * int(true.sum()) / len(true) if len(true) else np.nan


def _median_percent(log_errors: np.ndarray) -> float:
    return 100 * float(np.median(np.abs(np.expm1(log_errors)))) if len(log_errors) else np.nan


def camera_table(summaries: Sequence[MethodSummary]) -> str:
    """What summaries of cameras have besides, as a table below its heading."""
    fields = _CAMERA_COLUMNS.values()
    rows = [[s.method, *(decimals(getattr(s, name), d) for name, d in fields)] for s in summaries]
    return f"{_CAMERA_HEADING}\n{aligned([['method', *_CAMERA_COLUMNS], *rows])}"


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
