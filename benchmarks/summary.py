"""The figures of each method over all pairs, as data and as a table."""

from collections.abc import Iterable, Mapping, Sequence
from typing import Any

import numpy as np

from dgc_pose.benchmarks.files import decimals
from dgc_pose.benchmarks.metrics import pose_auc
from dgc_pose.benchmarks.reliability import Reliability
from dgc_pose.benchmarks.store import PairScore
from dgc_pose.estimation import EstimationOptions
from dgc_pose.estimation.probability import RIGHT_DEG
from dgc_pose.estimation.problem import THRESHOLD_FACTOR
from dgc_pose.system.texts import aligned

# One method over all pairs: the figures of `summarise` by name, which are the keys of summary.json.
Summary = Mapping[str, Any]
Columns = Mapping[str, tuple[str, int]]  # by heading a figure of a summary, and its decimals
COLUMNS: Columns = {
    "pairs": ("pairs", 0),
    "failures": ("failures", 0),
    "R med": ("median_rotation_deg", 2),
    "t med": ("median_translation_deg", 2),
    "t folded": ("median_translation_folded_deg", 2),
    **{f"AUC@{limit}": (f"auc{limit}", 1) for limit in (5, 10, 20)},
    "s/pair": ("seconds_per_pair", 2),
    "D_e all": ("median_epipolar_px", 2),
    "D_e conf": ("median_epipolar_confident_px", 2),
    "matches": ("matches_per_pair", 0),
    "pose s": ("pose_seconds_per_pair", 3),
}
CAMERA_HEADING = (
    "poses claimed, and wrong ones among them (over 10 degrees in R or t); doubted: the pose says "
    "that a K may be wrong;\n"
    "told: doubted, or no pose; p off: calibration error of the probability, points; in 90 %: "
    "share of right poses whose\n"
    "error is within the expected one; f: focal lengths of claimed poses, median error and share "
    "within two deviations,\n"
    "of all and of those with a deviation below 5 %; shares and errors in percent"
)
CAMERA_COLUMNS: Columns = {
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
_SURE_STD = 0.05  # of ln f: focal lengths of a smaller deviation are sure


def columns(scores: Iterable[PairScore]) -> dict[str, dict[str, np.ndarray]]:
    """The numbers of the records as arrays (N,), by method, in the order in which they come, and by
    field."""
    methods: dict[str, list[PairScore]] = {}
    for score in scores:
        methods.setdefault(score.method, []).append(score)
    return {
        method: {
            name: np.array([getattr(row, name) for row in rows], dtype=np.float64)
            for name, value in vars(rows[0]).items()
            if isinstance(value, int | float)
        }
        for method, rows in methods.items()
    }


def summarise(method: str, column: Mapping[str, np.ndarray]) -> Summary:
    """The figures of one method from the `columns` of its records; NaN for a share of nothing, and
    for what the method does not say."""
    rotation, translation = column["rotation_error_deg"], column["translation_error_deg"]
    folded = column["translation_folded_deg"]
    worse = np.maximum(rotation, folded)
    match, estimate = column["match_seconds"], column["estimate_seconds"]
    claimed, doubted = (column[name] > 0 for name in ("success", "doubts_camera"))
    right = claimed & (np.maximum(rotation, translation) <= RIGHT_DEG)
    expected = right & np.isfinite(column["rotation_90_deg"])
    probability = column["probability"]
    if not np.isfinite(probability[claimed]).any():  # that of a pair without a pose is 0
        probability = np.full(len(rotation), np.nan)
    probable = np.isfinite(probability)
    reliability = Reliability.of(probability[probable], right[probable])
    # Of the focal lengths of all claimed poses, two a pair
    error, std = (
        np.concatenate([column[f"focal{n}_{name}"][claimed] for n in (1, 2)])
        for name in ("error", "std")
    )
    fitted, sure = std > 0, (std > 0) & (std < _SURE_STD)
    within = np.abs(error) <= 2 * std
    return {
        "method": method,
        "pairs": len(rotation),
        "failures": int((~claimed).sum()),  # pairs without a pose
        # Over all pairs, a failure as infinite
        "median_rotation_deg": float(np.median(rotation)),
        "median_translation_deg": float(np.median(translation)),
        "median_translation_folded_deg": float(np.median(folded)),
        # Percent; of max(rotation, folded translation), a failure as infinite
        **{f"auc{limit}": pose_auc(worse, (limit,))[0] for limit in (5, 10, 20)},
        "seconds_per_pair": float(np.mean(match + estimate)),  # without reading the images
        # Medians over the pairs of the pairs' median D_e, pixels of the images that the methods saw
        "median_epipolar_px": float(np.median(column["epipolar_all_px"])),
        "median_epipolar_confident_px": float(np.median(column["epipolar_confident_px"])),
        "matches_per_pair": float(np.mean(column["num_matches"])),
        "match_seconds_per_pair": float(np.mean(match)),
        "pose_seconds_per_pair": float(np.mean(estimate)),
        "claimed": int(claimed.sum()),  # poses
        "wrong": int((claimed & ~right).sum()),  # over 10 degrees off in R or t (0 to 180)
        "doubted": int(doubted.sum()),  # of all pairs: by the pose a K may be wrong
        "told_percent": _share(doubted | ~claimed),
        # Expected calibration error, over the pairs that have a probability
        "probability_error_percent": 100 * reliability.calibration_error,
        # Of the right poses that expect an error: whether that of R, of t, is within
        "rotation_within_percent": _share((rotation <= column["rotation_90_deg"])[expected]),
        "translation_within_percent": _share(
            (translation <= column["translation_90_deg"])[expected]
        ),
        "median_focal_error_percent": _median_percent(error),
        "focal_within_percent": _share(within[fitted]),  # within two deviations
        "sure_percent": _share(sure),
        "sure_median_focal_error_percent": _median_percent(error[sure]),
        "sure_focal_within_percent": _share(within[sure]),
    }


def _share(true: np.ndarray) -> float:
    return 100 * int(true.sum()) / len(true) if len(true) else np.nan


def _median_percent(log_errors: np.ndarray) -> float:
    return 100 * float(np.median(np.abs(np.expm1(log_errors)))) if len(log_errors) else np.nan


def summary_table(summaries: Sequence[Summary], columns: Columns = COLUMNS) -> str:
    """A line a method; angles in degrees, AUC in percent, "-" for infinity and NaN."""
    rows = [
        [summary["method"], *(decimals(summary[name], digits) for name, digits in columns.values())]
        for summary in summaries
    ]
    return aligned([["method", *columns], *rows])


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
        "AUC in percent, of max(R, t folded); s/pair: matching and estimating; pose s: estimating\n"
        "D_e: median symmetric epipolar distance of a pair in pixels of the images seen, its "
        "median over pairs,\nover the map and over the pose's matches"
    )
