"""Calibration of a confidence: its mean against the share of correct matches (Guo et al., 2017),
and its diagram."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from typing import TYPE_CHECKING

import numpy as np

if TYPE_CHECKING:
    from matplotlib.axes import Axes


@dataclass(frozen=True, eq=False)
class Reliability:
    """Counts over equal bins of confidence in [0, 1]; counts of several parts can be added.

    Bin b of B has the confidences in [b / B, (b + 1) / B), the last one also 1.
    """

    counts: np.ndarray  # (B,) int, matches
    correct: np.ndarray  # (B,) int, correct matches
    confidence: np.ndarray  # (B,) float64, sum of their confidences

    @classmethod
    def of(cls, confidence: np.ndarray, correct: np.ndarray, bins: int = 10) -> Reliability:
        """Count matches. confidence: of any shape, in [0, 1]; correct: bool of the same shape."""
        values = confidence.astype(np.float64).ravel()
        index = np.minimum((values * bins).astype(np.intp), bins - 1)
        return cls(
            counts=np.bincount(index, minlength=bins),
            correct=np.bincount(index[correct.ravel()], minlength=bins),
            confidence=np.bincount(index, weights=values, minlength=bins),
        )

    def __add__(self, other: Reliability) -> Reliability:
        return Reliability(
            self.counts + other.counts,
            self.correct + other.correct,
            self.confidence + other.confidence,
        )

    @property
    def share_correct(self) -> np.ndarray:
        """Share (B,) of correct matches in each bin; NaN if the bin is empty."""
        return _quotient(self.correct, self.counts)

    @property
    def mean_confidence(self) -> np.ndarray:
        """Mean confidence (B,) of each bin; NaN if the bin is empty."""
        return _quotient(self.confidence, self.counts)

    @property
    def calibration_error(self) -> float:
        """Expected calibration error in [0, 1]: |mean confidence - share correct| of the bins,
        weighted by their counts. NaN without matches."""
        total = self.counts.sum()
        if total == 0:
            return float("nan")
        return float(np.abs(self.confidence - self.correct).sum() / total)


def draw_reliability(axes: Axes, reliabilities: Mapping[str, Reliability], *, right: str) -> None:
    """Draw the share of right matches by bin of confidence, a curve a method, and the diagonal.

    right: which matches are right, for the label.
    """
    axes.plot([0, 1], [0, 1], color="grey", linestyle="--", linewidth=1)
    for method, reliability in reliabilities.items():
        filled = reliability.counts > 0
        x, y = reliability.mean_confidence[filled], reliability.share_correct[filled]
        label = f"{method}, calibration error {100 * reliability.calibration_error:.1f} %"
        axes.plot(x, y, marker="o", ms=4, label=label)
    axes.set(xlim=(0, 1), ylim=(0, 1), ylabel=f"share of matches {right}")
    axes.grid(alpha=0.3)
    if reliabilities:
        axes.legend(loc="lower right", fontsize=9)


def _quotient(sums: np.ndarray, counts: np.ndarray) -> np.ndarray:
    return np.divide(sums, counts, out=np.full(len(counts), np.nan), where=counts > 0)
