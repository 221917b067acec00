"""The figures of each method over all pairs, as data and a table."""

from __future__ import annotations

import csv
import math
from collections.abc import Iterable, Mapping, Sequence
from pathlib import Path
from typing import Any

import numpy as np

from dgc_pose.benchmarks.evaluate import pose_auc
from dgc_pose.estimation import EstimationOptions
from dgc_pose.estimation.probability import RIGHT_DEG
from dgc_pose.estimation.problem import THRESHOLD_FACTOR
from dgc_pose.system.files import naming_path
from dgc_pose.system.texts import aligned, finite_or_none

# One method's figures over all pairs, from `summarise`, by name: the keys of summary.json.
Summary = Mapping[str, Any]
Columns = Mapping[str, tuple[str, int]]  # by heading: a figure of a summary, its decimals
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
    "poses claimed, and wrong ones among them (over 10 degrees in R or t); doubted: a warning that "
    "a K may be wrong;\n"
    "told: doubted or no pose; p off: calibration error of the probability, points; in 90 %: "
    "share of right poses whose\n"
    "error is within the expected one; f: focal lengths of claimed poses, median error and share "
    "within two deviations,\n"
    "of all and of the cameras with a deviation below 5 %; shares and errors in percent"
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
_SURE_STD = 0.05  # of ln f: a focal length with a smaller deviation is sure


def reliability(confidence: np.ndarray, correct: np.ndarray, bins: int = 10) -> np.ndarray:
    """For B equal bins of confidence in [0, 1]: number of matches, number of correct matches, and
    sum of confidences (Guo et al., 2017); (3, B). Results of several parts can be added.

    confidence: any shape, in [0, 1]; correct: bool of the same shape. Bin b has the confidences in
    [b / B, (b + 1) / B); the last bin also has 1.
    """
    values = confidence.astype(np.float64).ravel()
    index = np.minimum((values * bins).astype(np.intp), bins - 1)
    summed = np.ones(len(values)), correct.ravel(), values
    return np.stack([np.bincount(index, weights, minlength=bins) for weights in summed])


def shares(counts: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Share (B,) of correct matches and mean confidence (B,) in each bin of `reliability`; NaN for
    an empty bin."""
    with np.errstate(invalid="ignore"):
        return counts[1] / counts[0], counts[2] / counts[0]


def calibration_error(counts: np.ndarray) -> float:
    """Expected calibration error in [0, 1] of `reliability`: the mean of |mean confidence - share
    correct| over the bins, weighted by their counts. NaN without matches."""
    total = counts[0].sum()
    return float(np.abs(counts[2] - counts[1]).sum() / total) if total else np.nan


def columns(scores: Iterable[Mapping[str, Any]]) -> dict[str, dict[str, np.ndarray]]:
    """The numeric fields of the records as arrays (N,), by method in order of first appearance, and
    by field."""
    methods: dict[str, list[Mapping[str, Any]]] = {}
    for score in scores:
        methods.setdefault(score["method"], []).append(score)
    return {
        method: {
            name: np.array([row[name] for row in rows], dtype=np.float64)
            for name, value in rows[0].items()
            if isinstance(value, int | float)
        }
        for method, rows in methods.items()
    }


def summarise(method: str, column: Mapping[str, np.ndarray]) -> Summary:
    """The figures of one method from the `columns` of its records; NaN for a share of nothing, and
    for values that the method does not give."""
    rotation = column["rotation_error_deg"]
    translation = column["translation_error_deg"]
    folded = column["translation_folded_deg"]
    worse = np.maximum(rotation, folded)
    match = column["match_seconds"]
    estimate = column["estimate_seconds"]
    claimed, doubted = (column[name] > 0 for name in ("success", "doubts_camera"))
    right = claimed & (np.maximum(rotation, translation) <= RIGHT_DEG)
    expected = right & np.isfinite(column["rotation_90_deg"])
    probability = column["probability"]
    if not np.isfinite(probability[claimed]).any():  # a pair without a pose has probability 0
        probability = np.full(len(rotation), np.nan)
    probable = np.isfinite(probability)
    calibration = reliability(probability[probable], right[probable])
    # The focal lengths of all claimed poses, two for each pair
    error, std = (
        np.concatenate([column[f"focal{n}_{name}"][claimed] for n in (1, 2)])
        for name in ("error", "std")
    )
    fitted = std > 0
    sure = (std > 0) & (std < _SURE_STD)
    within = np.abs(error) <= 2 * std
    return {
        "method": method,
        "pairs": len(rotation),
        "failures": int((~claimed).sum()),  # pairs without a pose
        # Over all pairs; a failure counts as infinite
        "median_rotation_deg": float(np.median(rotation)),
        "median_translation_deg": float(np.median(translation)),
        "median_translation_folded_deg": float(np.median(folded)),
        # Percent, of max(rotation, folded translation); a failure counts as infinite
        **{f"auc{limit}": pose_auc(worse, limit) for limit in (5, 10, 20)},
        "seconds_per_pair": float(np.mean(match + estimate)),  # without reading the images
        # Medians over pairs of a pair's median D_e, in pixels of the images that the methods get
        "median_epipolar_px": float(np.median(column["epipolar_all_px"])),
        "median_epipolar_confident_px": float(np.median(column["epipolar_confident_px"])),
        "matches_per_pair": float(np.mean(column["num_matches"])),
        "match_seconds_per_pair": float(np.mean(match)),
        "pose_seconds_per_pair": float(np.mean(estimate)),
        "claimed": int(claimed.sum()),  # poses
        "wrong": int((claimed & ~right).sum()),  # over 10 degrees off in R or t (0 to 180)
        "doubted": int(doubted.sum()),  # of all pairs: a K may be wrong
        "told_percent": _share(doubted | ~claimed),
        # Expected calibration error, over the pairs with a probability
        "probability_error_percent": 100 * calibration_error(calibration),
        # Share of right poses whose error is within the expected one, where there is one
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
    """A table, a line for each method; angles in degrees, AUC in percent, "-" if not finite."""
    rows = [
        [summary["method"], *(decimals(summary[name], digits) for name, digits in columns.values())]
        for summary in summaries
    ]
    return aligned([["method", *columns], *rows])


def heading(options: EstimationOptions) -> str:
    """The estimator that all methods share, and the meaning of the table's columns."""
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


def decimals(value: float, digits: int) -> str:
    """The value with `digits` decimals; "-" for NaN and infinity."""
    return f"{value:.{digits}f}" if math.isfinite(value) else "-"


def finite_data(data: Any) -> Any:
    """Data for `json_text`: None in place of NaN and infinity at any depth."""
    if isinstance(data, Mapping):
        return {key: finite_data(value) for key, value in data.items()}
    if isinstance(data, list | tuple):
        return [finite_data(value) for value in data]
    return finite_or_none(data) if isinstance(data, float) else data


def write_rows(path: Path, rows: Sequence[Mapping[str, Any]]) -> None:
    """Write records as CSV. Raises OSError, with the path."""
    with naming_path(path), path.open("w", newline="", encoding="utf-8") as stream:
        writer = csv.DictWriter(stream, list(rows[0]))
        writer.writeheader()
        writer.writerows(rows)


def split_names(text: str) -> list[str]:
    """The names in a comma-separated list, stripped of blanks, without empty ones."""
    return [name for name in (part.strip() for part in text.split(",")) if name]
