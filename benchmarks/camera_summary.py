"""The figures of a method that was not told the true cameras."""

from collections.abc import Sequence
from dataclasses import asdict, dataclass

import numpy as np

from dgc_pose.benchmarks.files import decimals
from dgc_pose.benchmarks.scores import CameraScore
from dgc_pose.benchmarks.summary import MethodSummary, columns, summarise
from dgc_pose.estimation.probability import RIGHT_DEG
from dgc_pose.files.tables import aligned
from dgc_pose.metrics import Reliability

TOLD_STD = 0.05  # of ln f: the matches tell a focal length whose deviation is below
_HEADING = (
    "poses claimed, and wrong ones among them (over 10 degrees in R or t); doubted: the pose says "
    "that a K may be wrong;\n"
    "told: doubted, or no pose; p off: calibration error of the probability, points; in 90 %: "
    "share of right poses whose\n"
    "error is within the expected one; f: focal lengths of claimed poses, median error and share "
    "within two deviations,\n"
    "of all and of those with a deviation below 5 %; shares and errors in percent"
)
_COLUMNS = {  # field and decimals
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
class CameraSummary(MethodSummary):
    """With the focal lengths, and whether the claims hold; NaN for a share of nothing."""

    claimed: int  # poses
    wrong: int  # of them, over 10 degrees off in R or t (0 to 180)
    doubted: int  # of all pairs: the pose says that a K may be wrong
    told_percent: float  # doubted, or without a pose
    probability_error_percent: float  # expected calibration error, over the pairs that have one
    # Of the right poses that expect an error: whether that of R, of t, is within
    rotation_within_percent: float
    translation_within_percent: float
    # Of the focal lengths of all claimed poses, two a pair; those with a deviation below `TOLD_STD`
    # are sure
    median_focal_error_percent: float
    focal_within_percent: float  # error within two deviations, of those that have a deviation
    sure_percent: float
    sure_median_focal_error_percent: float
    sure_focal_within_percent: float


def camera_table(summaries: Sequence[CameraSummary]) -> str:
    """What the summaries have besides those of known cameras, as a table below its heading."""
    rows = [
        [one.method, *(decimals(getattr(one, name), digits) for name, digits in _COLUMNS.values())]
        for one in summaries
    ]
    return f"{_HEADING}\n{aligned([['method', *_COLUMNS], *rows])}"


def summarise_cameras(scores: Sequence[CameraScore]) -> CameraSummary:
    """As `summarise`, with what is of the cameras."""
    summary = summarise(scores)
    column = columns(scores)[summary.method]
    claimed, doubted = (column[name] > 0 for name in ("success", "doubts_camera"))
    rotation, translation = column["rotation_error_deg"], column["translation_error_deg"]
    right = claimed & (np.maximum(rotation, translation) <= RIGHT_DEG)
    expected = right & np.isfinite(column["rotation_90_deg"])
    probability = column["probability"]
    if not np.isfinite(probability[claimed]).any():  # that of a pair without a pose is 0
        probability = np.full(len(scores), np.nan)
    probable = np.isfinite(probability)
    error, std = (
        np.concatenate([column[f"focal{n}_{name}"][claimed] for n in (1, 2)])
        for name in ("error", "std")
    )
    fitted, sure = std > 0, (std > 0) & (std < TOLD_STD)
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
