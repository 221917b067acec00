"""Matches: the result of every matcher and the input of the estimation."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np

from dgc_pose.errors import InputError
from dgc_pose.system.options import check_type


@dataclass(frozen=True)
class Matches:
    """Point matches between two images, in pixels of the original images.

    Points of OpenCV's shape (N, 1, 2), or of a batch of one, (1, N, 2), become (N, 2). Raises
    InputError if the shapes do not agree or a value is out of range. Coordinates may be non-finite:
    the estimation drops and counts such matches.

    Attributes:
        points1: Points (N, 2) float64 in image 1, pixels of the original.
        points2: Points (N, 2) float64 in image 2, pixels of the original.
        confidence: Confidence (N,) float64 in [0, 1]; for matches of a map, the matchability.
        error_px: Expected error of a good match, pixels of the original images; positive. If it is
            not known, one pixel of the image that the matcher saw.
        key_points: Whether the matches are independent detections (key points). In matches of a
            dense map, errors of neighbours are correlated.
        weights: Fingerprint of the weights of the network that made the matches; None for other
            matchers. The probability of a pose is fitted on key points of any detector, and on
            matches of the dense maps of certain weights.
        context_ratio: Similarity of the images around the matches divided by that at the matches,
            any finite number; None if it is unknown or nothing surrounds the matches.
    """

    points1: np.ndarray
    points2: np.ndarray
    confidence: np.ndarray
    error_px: float
    key_points: bool = False
    weights: str | None = None
    context_ratio: float | None = None

    def __post_init__(self) -> None:
        for name in ("points1", "points2"):
            points = np.asarray(getattr(self, name), dtype=np.float64)
            if points.ndim == 3 and 1 in points.shape[:2]:
                points = points.reshape(-1, points.shape[2])
            if points.ndim != 2 or points.shape[1] != 2:
                raise InputError(f"{name} must have shape (N, 2), not {points.shape}")
            object.__setattr__(self, name, points)
        confidence = np.asarray(self.confidence, dtype=np.float64)
        object.__setattr__(self, "confidence", confidence)
        counts = (len(self.points1), len(self.points2))
        if counts[0] != counts[1] or confidence.shape != (counts[0],):
            raise InputError(
                f"points1, points2 and confidence must have the same length, "
                f"not {counts[0]}, {counts[1]} and {confidence.shape}"
            )
        outside = confidence[~((confidence >= 0) & (confidence <= 1))]
        if len(outside):
            raise InputError(f"confidence must lie in 0 to 1, not {outside[0]}")
        check_type(self.error_px, float, "error_px")
        if not 0 < self.error_px < math.inf:
            raise InputError(f"error_px must be positive and finite, not {self.error_px}")
        if self.context_ratio is not None and not math.isfinite(self.context_ratio):
            raise InputError(f"context_ratio must be finite or None, not {self.context_ratio}")

    def __repr__(self) -> str:
        kind = "key points" if self.key_points else "of a dense map"
        return f"Matches({len(self)} {kind}, error_px={self.error_px:.3g})"

    def subset(self, kept: np.ndarray) -> Matches:
        """Some of the matches. kept: (N,) bool, or indices."""
        return replace(
            self,
            points1=self.points1[kept],
            points2=self.points2[kept],
            confidence=self.confidence[kept],
        )

    def swapped(self) -> Matches:
        """The matches from image 2 to image 1."""
        return replace(self, points1=self.points2, points2=self.points1)

    @classmethod
    def joined(cls, parts: Sequence[Matches]) -> Matches:
        """The matches of all parts, without repeated ones (the same to the pixel). The expected
        error is the largest of the parts; all else is from the first part."""
        points1, points2, confidence = (
            np.concatenate([getattr(part, name) for part in parts])
            for name in ("points1", "points2", "confidence")
        )
        pixels = np.round(np.column_stack([points1, points2]))
        _, first = np.unique(pixels, axis=0, return_index=True)
        error = max(part.error_px for part in parts)
        joined = replace(
            parts[0], points1=points1, points2=points2, confidence=confidence, error_px=error
        )
        return joined.subset(np.sort(first))

    def __len__(self) -> int:
        return len(self.points1)
