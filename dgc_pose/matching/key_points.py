"""Matchers of key points: what they detect in an image is kept for its next pair."""

from abc import ABC, abstractmethod
from typing import NamedTuple

import numpy as np

from dgc_pose.images.image import Image
from dgc_pose.matches import Matches
from dgc_pose.matching.cache import ImageCache, LastImages
from dgc_pose.matching.matcher import Matcher, MatchResult


class KeyPoints(NamedTuple):
    """The key points of an image and their descriptors."""

    points: np.ndarray  # (N, 2), pixels of the image
    descriptors: np.ndarray  # (N, D)

    @property
    def nbytes(self) -> int:
        return self.points.nbytes + self.descriptors.nbytes


class KeyPointMatcher(Matcher, ABC):
    """Detects key points with descriptors in each image alone, and matches these; makes no map.

    cache: of key points; None to keep those of the last three images.
    """

    def __init__(self, cache: ImageCache | None = None) -> None:
        self.cache = cache or LastImages()

    @abstractmethod
    def _detect(self, image: Image) -> KeyPoints:
        """Detect in an image."""

    @abstractmethod
    def _matched(
        self, descriptors1: np.ndarray, descriptors2: np.ndarray
    ) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
        """Rows of the first (M,) and of the second (M,) that match, and their confidence (M,)."""

    @abstractmethod
    def _error_px(self, image1: Image, image2: Image) -> float:
        """Expected error of a good match, pixels of the images."""

    def _match(self, image1: Image, image2: Image) -> MatchResult:
        points1, descriptors1 = self.cache.get((image1,), lambda: self._detect(image1))
        points2, descriptors2 = self.cache.get((image2,), lambda: self._detect(image2))
        rows1 = rows2 = np.zeros(0, int)
        confidence = np.zeros(0)
        if min(len(points1), len(points2)) > 1:  # a ratio test needs a second one
            rows1, rows2, confidence = self._matched(descriptors1, descriptors2)
        error_px = self._error_px(image1, image2)
        matches = Matches(points1[rows1], points2[rows2], confidence, error_px, key_points=True)
        return MatchResult(matches, None)
