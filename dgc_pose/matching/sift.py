"""SIFT as a matcher, for comparison through the same estimator."""

from __future__ import annotations

from dataclasses import dataclass

import cv2
import numpy as np

from dgc_pose.images.image import Image
from dgc_pose.matches import Matches
from dgc_pose.matching.cache import BoundedCache
from dgc_pose.matching.matcher import Matcher, MatchResult
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


# Key points (N, 2) and descriptors (N, 128) by image; keyed by the object, not by its pixels.
KeyPointCache = BoundedCache[Image, tuple[np.ndarray, np.ndarray]]


def key_point_cache() -> KeyPointCache:
    """A cache of the default size. The images that it keeps alive count towards it."""
    return BoundedCache(
        lambda image, found: image.pixels.nbytes + found[0].nbytes + found[1].nbytes
    )


class SiftMatcher(Matcher):
    """Matches by SIFT key points on the original images; makes no map.

    cache: of key points; None to detect them anew for each pair.
    """

    def __init__(
        self, options: SiftOptions | None = None, cache: KeyPointCache | None = None
    ) -> None:
        self.options = options or SiftOptions()
        self.cache = cache

    @property
    def name(self) -> str:
        return "sift"

    def _match(self, image1: Image, image2: Image) -> MatchResult:
        """Mutual nearest neighbours that pass the ratio test; confidence 1 - distance ratio."""
        return MatchResult(self._matches(image1, image2), None)

    def _matches(self, image1: Image, image2: Image) -> Matches:
        points1, descriptors1 = self._key_points(image1)
        points2, descriptors2 = self._key_points(image2)
        if len(points1) < 2 or len(points2) < 2:
            none = np.zeros((0, 2))
            return Matches(none, none, np.zeros(0), ERROR_PX, key_points=True)
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
        return Matches(points1[first], points2[second], table[:, 2], ERROR_PX, key_points=True)

    def _key_points(self, image: Image) -> tuple[np.ndarray, np.ndarray]:
        """Key points (N, 2), pixels of the image, and their descriptors (N, 128) float32."""
        if self.cache is None:
            return self._detect(image)
        return self.cache.get(image, lambda: self._detect(image))

    def _detect(self, image: Image) -> tuple[np.ndarray, np.ndarray]:
        detector = cv2.SIFT.create(nfeatures=self.options.features)
        grey = cv2.cvtColor(image.pixels, cv2.COLOR_RGB2GRAY)
        points, descriptors = detector.detectAndCompute(grey, None)
        if descriptors is None:
            return np.zeros((0, 2)), np.zeros((0, 128), np.float32)
        return np.array([p.pt for p in points], dtype=np.float64), descriptors
