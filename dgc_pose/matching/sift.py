"""SIFT as a matcher, for comparison through the same estimator."""

from __future__ import annotations

from dataclasses import dataclass

import cv2
import numpy as np

from dgc_pose.images.image import Image
from dgc_pose.matching.key_points import KeyPointCache, KeyPointMatcher, KeyPoints
from dgc_pose.system.options import check_options, option

ERROR_PX = 1.0  # of a SIFT match, pixels of the originals


@dataclass(frozen=True)
class SiftOptions:
    """OpenCV's SIFT with Lowe's ratio test and a mutual check (Lowe, IJCV 2004, section 7.1).

    Raises InputError, naming the field, for a value out of range.
    """

    features: int = option(8000, min=1)  # at most, of each image
    # Largest ratio of the distances to the nearest and the second nearest descriptor.
    ratio: float = option(0.8, above=0, max=1)

    def __post_init__(self) -> None:
        check_options(self)


class SiftMatcher(KeyPointMatcher):
    """Mutual nearest neighbours that pass the ratio test; the confidence is 1 - distance ratio."""

    def __init__(
        self, options: SiftOptions | None = None, cache: KeyPointCache | None = None
    ) -> None:
        super().__init__(cache)
        self.options = options or SiftOptions()

    @property
    def name(self) -> str:
        return "sift"

    def _detect(self, image: Image) -> KeyPoints:
        detector = cv2.SIFT.create(nfeatures=self.options.features)
        grey = cv2.cvtColor(image.pixels, cv2.COLOR_RGB2GRAY)
        points, descriptors = detector.detectAndCompute(grey, None)
        if descriptors is None:
            return np.zeros((0, 2)), np.zeros((0, 128), np.float32)
        return np.array([point.pt for point in points], dtype=np.float64), descriptors

    def _matched(
        self, descriptors1: np.ndarray, descriptors2: np.ndarray
    ) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
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
        return table[:, 0].astype(int), table[:, 1].astype(int), table[:, 2]

    def _error_px(self, image1: Image, image2: Image) -> float:
        return ERROR_PX
