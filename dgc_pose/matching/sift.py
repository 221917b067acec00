"""SIFT as a matcher: what a user would reach for instead, through the same estimator."""

from __future__ import annotations

from dataclasses import dataclass

import cv2
import numpy as np

from dgc_pose.image import Image
from dgc_pose.matches import Matches

_ERROR_PX = 1.0  # of a SIFT match, pixels of the originals


@dataclass(frozen=True)
class SiftOptions:
    """OpenCV's SIFT with Lowe's ratio test and a mutual check."""

    features: int = 8000  # at most, of each image
    ratio: float = 0.8  # largest distance to the best neighbour, of that to the second best


class SiftMatcher:
    """Matches by SIFT key points on the original images."""

    def __init__(self, options: SiftOptions | None = None) -> None:
        self.options = options or SiftOptions()

    @property
    def name(self) -> str:
        return "sift"

    def match(self, image1: Image, image2: Image) -> Matches:
        """Mutual nearest neighbours that pass the ratio test; confidence 1 - distance ratio."""
        points1, descriptors1 = self._detect(image1)
        points2, descriptors2 = self._detect(image2)
        if len(points1) < 2 or len(points2) < 2:
            return Matches(np.zeros((0, 2)), np.zeros((0, 2)), np.zeros(0), _ERROR_PX)
        matcher = cv2.BFMatcher(cv2.NORM_L2)
        forward = matcher.knnMatch(descriptors1, descriptors2, k=2)
        backward = {m.queryIdx: m.trainIdx for m in matcher.match(descriptors2, descriptors1)}
        kept = [
            (best.queryIdx, best.trainIdx, 1 - best.distance / max(second.distance, 1e-12))
            for best, second in forward
            if best.distance < self.options.ratio * second.distance
            and backward[best.trainIdx] == best.queryIdx
        ]
        table = np.array(kept, dtype=np.float64).reshape(-1, 3)
        first, second = table[:, 0].astype(int), table[:, 1].astype(int)
        return Matches(points1[first], points2[second], table[:, 2], _ERROR_PX)

    def _detect(self, image: Image) -> tuple[np.ndarray, np.ndarray]:
        detector = cv2.SIFT.create(nfeatures=self.options.features)
        grey = cv2.cvtColor(image.pixels, cv2.COLOR_RGB2GRAY)
        points, descriptors = detector.detectAndCompute(grey, None)
        if descriptors is None:
            return np.zeros((0, 2)), np.zeros((0, 128), np.float32)
        return np.array([p.pt for p in points], dtype=np.float64), descriptors
