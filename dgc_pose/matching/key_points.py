"""Matchers of key points: what they detect in an image is kept for its next pair."""

from abc import ABC, abstractmethod

import numpy as np

from dgc_pose.images.image import Image
from dgc_pose.matches import Matches
from dgc_pose.matching.cache import BoundedCache
from dgc_pose.matching.matcher import Matcher, MatchResult

KeyPoints = tuple[np.ndarray, np.ndarray]  # points (N, 2), pixels of the image; descriptors (N, D)
KeyPointCache = BoundedCache[Image, KeyPoints]  # by the object, not by its pixels


def key_point_cache() -> KeyPointCache:
    """A cache of the default size. The images that it keeps alive count towards it."""
    return BoundedCache(
        lambda image, arrays: image.pixels.nbytes + sum(array.nbytes for array in arrays)
    )


class KeyPointMatcher(Matcher, ABC):
    """Detects key points with descriptors in each image alone, and matches these; makes no map.

    cache: of key points; None to detect them anew for each pair.
    """

    def __init__(self, cache: KeyPointCache | None = None) -> None:
        self.cache = cache

    @abstractmethod
    def _detect(self, image: Image) -> KeyPoints:
        """The key points of an image and their descriptors."""

    @abstractmethod
    def _matched(
        self, descriptors1: np.ndarray, descriptors2: np.ndarray
    ) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
        """Rows of the first (M,) and of the second (M,) that match, and their confidence (M,)."""

    @abstractmethod
    def _error_px(self, image1: Image, image2: Image) -> float:
        """Expected error of a good match, pixels of the images."""

    def _match(self, image1: Image, image2: Image) -> MatchResult:
        cache = self.cache or key_point_cache()
        points1, descriptors1 = cache.get(image1, lambda: self._detect(image1))
        points2, descriptors2 = cache.get(image2, lambda: self._detect(image2))
        rows1 = rows2 = np.zeros(0, int)
        confidence = np.zeros(0)
        if min(len(points1), len(points2)) > 1:  # a ratio test needs a second one
            rows1, rows2, confidence = self._matched(descriptors1, descriptors2)
        error_px = self._error_px(image1, image2)
        matches = Matches(points1[rows1], points2[rows2], confidence, error_px, key_points=True)
        return MatchResult(matches, None)
