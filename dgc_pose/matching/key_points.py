"""Matchers of key points: what they detect in an image is kept for its next pair. SIFT, for
comparison through the same estimator."""

from abc import ABC, abstractmethod
from typing import NamedTuple

import cv2
import numpy as np

from dgc_pose.images.image import Image
from dgc_pose.matches import Matches
from dgc_pose.matching.cache import ImageCache
from dgc_pose.matching.matcher import Matcher, MatchResult

ERROR_PX = 1.0  # of a SIFT match, pixels of the originals
FEATURES = 8000  # of SIFT of an image at most
RATIO = 0.8  # largest, of the distances to the nearest and the second nearest descriptor


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
        self.cache = cache or ImageCache()

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


class SiftMatcher(KeyPointMatcher):
    """OpenCV's SIFT: mutual nearest neighbours that pass the ratio test (Lowe, IJCV 2004, section
    7.1); the confidence is 1 - distance ratio."""

    name = "sift"

    def _detect(self, image: Image) -> KeyPoints:
        detector = cv2.SIFT.create(nfeatures=FEATURES)
        grey = cv2.cvtColor(image.pixels, cv2.COLOR_RGB2GRAY)
        points, descriptors = detector.detectAndCompute(grey, None)
        if descriptors is None:
            return KeyPoints(np.zeros((0, 2)), np.zeros((0, 128), np.float32))
        return KeyPoints(np.array([point.pt for point in points], np.float64), descriptors)

    def _matched(
        self, descriptors1: np.ndarray, descriptors2: np.ndarray
    ) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
        matcher = cv2.BFMatcher(cv2.NORM_L2)
        forward = matcher.knnMatch(descriptors1, descriptors2, k=2)
        backward = {m.queryIdx: m.trainIdx for m in matcher.match(descriptors2, descriptors1)}
        kept = [
            (best.queryIdx, best.trainIdx, 1 - best.distance / max(second.distance, 1e-12))
            for best, second in forward
            if best.distance < RATIO * second.distance and backward[best.trainIdx] == best.queryIdx
        ]
        table = np.array(kept, dtype=np.float64).reshape(-1, 3)
        return table[:, 0].astype(int), table[:, 1].astype(int), table[:, 2]

    def _error_px(self, image1: Image, image2: Image) -> float:
        return ERROR_PX
