"""SIFT as a matcher, for comparison through the same estimator."""

import cv2
import numpy as np

from dgc_pose.images.image import Image
from dgc_pose.matching.key_points import KeyPointMatcher, KeyPoints

ERROR_PX = 1.0  # of a SIFT match, pixels of the originals
FEATURES = 8000  # of an image at most
RATIO = 0.8  # largest, of the distances to the nearest and the second nearest descriptor


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
