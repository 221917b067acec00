"""Figures of dense maps as the paper gives them: of one pair, and over the pairs of a group.

AEPE and Jaccard are means over pairs of a pair's own figure; PCK is pooled over pixels. All errors
are in pixels of the 240x240 images, over the pixels whose true correspondence is known.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np

from dgc_pose.benchmarks.reliability import Reliability
from dgc_pose.network.config import INPUT_SIZE, LEVEL_SIZES

PCK_ALPHAS = np.linspace(0.005, 0.1, 200)  # of 240: the paper's thresholds
PCK_THRESHOLDS = PCK_ALPHAS * INPUT_SIZE  # pixels
WITHIN = (1.0, 3.0, 5.0)  # pixels, Euclidean: PCK@1, PCK@3, PCK@5
RIGHT_PX = 3.0  # a match this near is right, in the reliability diagram
# The mask of dgcm-lite0 is trained on "visible, with an error below" so many pixels.
FOUND_PX = 4.0


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
    """One method's figures of a pair, or of several together."""

    method: str
    group: str
    name: str  # of the pair; "" of several
    pairs: int
    valid: int  # pixels of known correspondence; without any, the errors below are NaN
    aepe: float  # pixels, mean over the pairs that have valid pixels
    # The same of the maps of 15 to 240 cells a side; NaN for one that the method has not
    level_aepe: tuple[float, ...]
    near: np.ndarray  # (200,) int, valid pixels within each of PCK_THRESHOLDS
    within: np.ndarray  # (3,) int, valid pixels within each of WITHIN
    jaccard: float  # of the mask against the visible pixels, mean over pairs; NaN without a mask
    jaccard_found: float  # the same against the pixels visible and found to within FOUND_PX
    reliability: Reliability | None  # of matches within RIGHT_PX; None without a mask

    @property
    def pck(self) -> np.ndarray:
        """Share (200,) of all valid pixels within each of PCK_THRESHOLDS; NaN without any."""
        return self.near / self.valid if self.valid else np.full(self.near.shape, np.nan)

    @property
    def data(self) -> dict[str, Any]:
        """The figures by name: a row of the tables and of pairs.csv."""
        levels = zip(LEVEL_SIZES[::-1], self.level_aepe, strict=True)
        shares = zip(WITHIN, self.within.tolist(), strict=True)
        return {
            "group": self.group,
            "pair": self.name,
            "method": self.method,
            "pairs": self.pairs,
            "valid_pixels": self.valid,
            "aepe": self.aepe,
            **{f"aepe{cells}": aepe for cells, aepe in levels},
            **{f"pck{px:g}": count / self.valid if self.valid else np.nan for px, count in shares},
            "jaccard": self.jaccard,
            "jaccard_found": self.jaccard_found,
        }


def score_map(method: str, group: str, name: str, comparison: Comparison) -> MapScore:
    """The figures of one pair."""
    valid, matchability = comparison.levels[-1].valid, comparison.matchability
    levels = [level.errors for level in comparison.levels]
    distances = levels[-1]
    overlap = overlap_found = float("nan")
    reliability = None
    absent = len(LEVEL_SIZES) - len(levels)
    if matchability is not None:
        overlap = jaccard(matchability > 0.5, valid)
        overlap_found = jaccard(matchability > 0.5, distances < FOUND_PX)
        reliability = Reliability.of(matchability, distances <= RIGHT_PX)
    of_levels = (_mean(d[level.valid]) for d, level in zip(levels, comparison.levels, strict=True))
    return MapScore(
        method=method,
        group=group,
        name=name,
        pairs=1,
        valid=int(valid.sum()),
        aepe=_mean(distances[valid]),
        level_aepe=(float("nan"),) * absent + tuple(of_levels),
        near=count_within(distances[valid], PCK_THRESHOLDS),
        within=count_within(distances[valid], WITHIN),
        jaccard=overlap,
        jaccard_found=overlap_found,
        reliability=reliability,
    )


def pooled(scores: Sequence[MapScore], group: str = "all") -> MapScore:
    """The figures of one method over its pairs of a group."""
    scores = [pair for pair in scores if group in ("all", pair.group)]
    levels = zip(*(pair.level_aepe for pair in scores), strict=True)
    parts = [pair.reliability for pair in scores if pair.reliability is not None]
    return MapScore(
        method=scores[0].method,
        group=group,
        name="",
        pairs=len(scores),
        valid=sum(pair.valid for pair in scores),
        aepe=_mean([pair.aepe for pair in scores if pair.valid]),
        # A pair may have valid cells at a fine level and none at a coarse one.
        level_aepe=tuple(_mean([v for v in values if not np.isnan(v)]) for values in levels),
        near=np.sum([pair.near for pair in scores], axis=0),
        within=np.sum([pair.within for pair in scores], axis=0),
        jaccard=_mean([pair.jaccard for pair in scores]),
        jaccard_found=_mean([pair.jaccard_found for pair in scores]),
        reliability=sum(parts[1:], parts[0]) if parts else None,
    )


def count_within(errors: np.ndarray, thresholds: Sequence[float] | np.ndarray) -> np.ndarray:
    """Number (K,) of errors (N,) that are at most each threshold (K,); NaN never is.

    Over N this is the "percentage of correct keypoints" (PCK).
    """
    # NaN sorts last, beyond every threshold.
    return np.searchsorted(np.sort(errors), np.asarray(thresholds, np.float64), side="right")


def jaccard(prediction: np.ndarray, truth: np.ndarray) -> float:
    """Intersection over union of two bool masks of the same shape, in [0, 1]; 1 if both are
    empty."""
    union = int((prediction | truth).sum())
    return int((prediction & truth).sum()) / union if union else 1.0


def _mean(values: Sequence[float] | np.ndarray) -> float:
    return float(np.mean(values)) if len(values) else float("nan")
