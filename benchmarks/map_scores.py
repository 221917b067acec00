"""Figures of dense maps as the paper gives them: of one pair, over the pairs of a group, and their
report.

AEPE and Jaccard are means over pairs of a pair's own figure; PCK is pooled over pixels. All errors
are in pixels of the 240x240 images, over the pixels whose true correspondence is known.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np

from dgc_pose.benchmarks.files import decimals, finite_data
from dgc_pose.benchmarks.reliability import Reliability
from dgc_pose.network.config import INPUT_SIZE, LEVEL_SIZES
from dgc_pose.system.texts import aligned

PCK_ALPHAS = np.linspace(0.005, 0.1, 200)  # of 240: the paper's thresholds
PCK_THRESHOLDS = PCK_ALPHAS * INPUT_SIZE  # pixels
WITHIN = (1.0, 3.0, 5.0)  # pixels, Euclidean: PCK@1, PCK@3, PCK@5
RIGHT_PX = 3.0  # a match this near is right, in the reliability diagram
# The mask of dgcm-lite0 is trained on "visible, with an error below" so many pixels.
FOUND_PX = 4.0
HEADING = (
    "errors in pixels of 240x240, over the pixels of known correspondence, no mask applied\n"
    "AEPE: mean of a pair, then over pairs; AEPE@15 to @240: of each level's map of a network\n"
    "PCK@1, 3, 5: percent of all pixels within so many, Euclidean\n"
    "Jaccard: the mask (matchability above one half) against what is visible, mean over pairs;\n"
    f"J found: against what is visible and found to within {FOUND_PX:g} px, "
    "which dgcm-lite's mask is trained for"
)
_LEVELS = [f"aepe{cells}" for cells in LEVEL_SIZES[::-1]]  # of the maps of 15 to 240 cells a side
# Heading, figure, factor and decimals.
_COLUMNS = [
    ("pairs", "pairs", 1, 0),
    ("AEPE", "aepe", 1, 2),
    *((name.replace("aepe", "AEPE@"), name, 1, 2) for name in _LEVELS),
    *((f"PCK@{limit:g}", f"pck{limit:g}", 100, 1) for limit in WITHIN),
    ("Jaccard", "jaccard", 1, 3),
    ("J found", "jaccard_found", 1, 3),
]


@dataclass(frozen=True, eq=False)
class LevelMap:
    """A level's map of one pair and the true one, in pixels of the 240x240 input."""

    points: np.ndarray  # (S, S, 2) float32, for each cell of the target a point of the source
    truth: np.ndarray  # (S, S, 2) float32
    valid: np.ndarray  # (S, S) bool, cells of known truth

    @property
    def errors(self) -> np.ndarray:
        """Euclidean distances (S, S) float64 of map and truth, pixels; infinite without truth."""
        offsets = self.points[self.valid].astype(np.float64) - self.truth[self.valid]
        distances = np.full(self.valid.shape, np.inf)
        distances[self.valid] = np.linalg.norm(offsets, axis=1)
        return distances


@dataclass(frozen=True, eq=False)
class Comparison:
    """A method's maps and mask of one pair, with the truth."""

    levels: tuple[LevelMap, ...]  # coarse to fine, up to 240 cells a side; of a network from 15 on
    matchability: np.ndarray | None  # (240, 240) float32 in [0, 1]; None without a mask


@dataclass(frozen=True, eq=False)
class MapScore:
    """One method's figures of a pair, or of several together.

    means: mean over the pairs, NaN where nothing is known: `aepe`, pixels, and that of each level
    of a network, `aepe15` to `aepe240`; `jaccard`, of the mask against the visible pixels, and
    `jaccard_found`, against those that are visible and found to within FOUND_PX.
    """

    method: str
    group: str
    name: str  # of the pair; "" of several
    valid: int  # pixels of known correspondence
    means: Mapping[str, float]
    near: np.ndarray  # (200,) int, valid pixels within each of PCK_THRESHOLDS
    within: np.ndarray  # (3,) int, valid pixels within each of WITHIN
    reliability: Reliability | None  # of matches within RIGHT_PX; None without a mask
    pairs: int = 1

    @property
    def pck(self) -> np.ndarray:
        """Share (200,) of all valid pixels within each of PCK_THRESHOLDS; NaN without any."""
        return self.near / self.valid if self.valid else np.full(self.near.shape, np.nan)

    @property
    def data(self) -> dict[str, Any]:
        """The figures by name: a row of the tables and of pairs.csv."""
        shares = zip(WITHIN, self.within.tolist(), strict=True)
        return {
            "group": self.group,
            "pair": self.name,
            "method": self.method,
            "pairs": self.pairs,
            "valid_pixels": self.valid,
            **self.means,
            **{f"pck{px:g}": count / self.valid if self.valid else np.nan for px, count in shares},
        }


def score_map(method: str, group: str, name: str, comparison: Comparison) -> MapScore:
    """The figures of one pair."""
    valid, matchability = comparison.levels[-1].valid, comparison.matchability
    distances = comparison.levels[-1].errors
    means = dict.fromkeys(("aepe", *_LEVELS, "jaccard", "jaccard_found"), float("nan"))
    for level, of in zip(_LEVELS[::-1], comparison.levels[::-1], strict=False):
        means[level] = _mean(of.errors[of.valid])
    means["aepe"] = means[_LEVELS[-1]]
    reliability = None
    if matchability is not None:
        means["jaccard"] = jaccard(matchability > 0.5, valid)
        means["jaccard_found"] = jaccard(matchability > 0.5, distances < FOUND_PX)
        reliability = Reliability.of(matchability, distances <= RIGHT_PX)
    # The "percentage of correct keypoints" (PCK) of each threshold.
    ordered = np.sort(distances[valid])
    near, within = (np.searchsorted(ordered, t, side="right") for t in (PCK_THRESHOLDS, WITHIN))
    return MapScore(method, group, name, int(valid.sum()), means, near, within, reliability)


def pooled(scores: Sequence[MapScore], group: str = "all") -> MapScore:
    """The figures of one method over its pairs of a group."""
    scores = [pair for pair in scores if group in ("all", pair.group)]
    parts = [pair.reliability for pair in scores if pair.reliability is not None]
    # A pair may have valid cells at a fine level and none at a coarse one.
    known = {
        name: [pair.means[name] for pair in scores if not np.isnan(pair.means[name])]
        for name in scores[0].means
    }
    return MapScore(
        method=scores[0].method,
        group=group,
        name="",
        valid=sum(pair.valid for pair in scores),
        means={name: _mean(values) for name, values in known.items()},
        near=np.sum([pair.near for pair in scores], axis=0),
        within=np.sum([pair.within for pair in scores], axis=0),
        reliability=sum(parts[1:], parts[0]) if parts else None,
        pairs=len(scores),
    )


def jaccard(prediction: np.ndarray, truth: np.ndarray) -> float:
    """Intersection over union of two bool masks of the same shape, in [0, 1]; 1 if both are
    empty."""
    union = int((prediction | truth).sum())
    return int((prediction & truth).sum()) / union if union else 1.0


def _mean(values: Sequence[float] | np.ndarray) -> float:
    return float(np.mean(values)) if len(values) else float("nan")


Scores = Mapping[str, Sequence[MapScore]]  # by method, each over the same pairs


def groups_of(scores: Scores) -> list[str]:
    """The groups of the pairs, in their first order."""
    return list(dict.fromkeys(pair.group for pair in next(iter(scores.values()))))


def maps_table(scores: Scores) -> str:
    """A line a group and method, and over all pairs."""
    lines = [["group", "method", *(column[0] for column in _COLUMNS)]]
    for group in [*groups_of(scores), "all"]:
        for method, pairs in scores.items():
            data = pooled(pairs, group).data
            cells = (decimals(factor * data[name], n) for _, name, factor, n in _COLUMNS)
            lines.append([group, method, *cells])
    return aligned(lines)


def reliability_lines(scores: Scores) -> list[str]:
    """For each method that has a mask, the share of right matches by matchability, on one line."""
    lines = []
    for method, pairs in scores.items():
        if (reliability := pooled(pairs).reliability) is not None:
            shares = " ".join(decimals(100 * v, 0) for v in reliability.share_correct)
            lines.append(
                f"{method}: percent within {RIGHT_PX:g} px by tenths of matchability: {shares}; "
                "expected calibration error "
                f"{decimals(100 * reliability.calibration_error, 1)} %"
            )
    return lines


def report_data(scores: Scores) -> dict[str, Any]:
    """All figures, with null for one that is NaN: of each group and of all pairs by each method."""
    methods = []
    for method, pairs in scores.items():
        total = pooled(pairs)
        reliability = None
        if total.reliability is not None:
            reliability = {
                "right_within_px": RIGHT_PX,
                "counts": total.reliability.counts.tolist(),
                "share_correct": total.reliability.share_correct.tolist(),
                "mean_confidence": total.reliability.mean_confidence.tolist(),
                "expected_calibration_error": total.reliability.calibration_error,
            }
        methods.append(
            {
                "method": method,
                "all": {**total.data, "pck": total.pck.tolist()},
                "groups": [pooled(pairs, group).data for group in groups_of(scores)],
                "reliability": reliability,
            }
        )
    return {"pck_thresholds_px": PCK_THRESHOLDS.tolist(), "methods": finite_data(methods)}
