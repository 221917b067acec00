"""ArUco and AprilTag markers in an image."""

from functools import cache

import cv2
import numpy as np

# The largest dictionary of each kind contains the markers of the smaller ones.
_KINDS = (
    *("4X4_1000", "5X5_1000", "6X6_1000", "7X7_1000", "ARUCO_ORIGINAL", "ARUCO_MIP_36h12"),
    *("APRILTAG_16h5", "APRILTAG_25h9", "APRILTAG_36h10", "APRILTAG_36h11"),
)
_MARGIN = 0.4  # around a marker, as a share of its size, for fitting lines to its sides


def find_markers(pixels: np.ndarray) -> dict[str, np.ndarray]:
    """Find markers: their corners (4, 2), pixels, clockwise from the marker's top left, by
    dictionary and number, such as "APRILTAG_36h11:7". Skips a marker that appears twice.

    pixels: (H, W[, C]). Some detections are squares of a texture: only trust a marker that several
    images show.
    """
    grey = pixels if pixels.ndim == 2 else pixels[:, :, 1]
    grey = cv2.normalize(grey, None, 0, 255, cv2.NORM_MINMAX, cv2.CV_8U)  # type: ignore[call-overload]
    rough, found = _markers(grey, cv2.aruco.CORNER_REFINE_NONE), {}
    names = [name for name, _ in rough]
    for name, corners in rough:
        margin = _MARGIN * np.ptp(corners, axis=0).max()
        x, y = (corners.min(0) - margin).clip(0).astype(int)
        right, bottom = (corners.max(0) + margin).astype(int)
        # Lines along the sides avoid the bias of blurred corners, but are slow in a whole image.
        refined = dict(_markers(grey[y:bottom, x:right], cv2.aruco.CORNER_REFINE_APRILTAG))
        if name in refined and names.count(name) == 1:
            found[name] = refined[name] + (x, y) - 0.5  # there, (0, 0) is a pixel's corner
    return found


@cache
def _detector(refinement: int) -> cv2.aruco.ArucoDetector:
    settings = cv2.aruco.DetectorParameters()
    settings.cornerRefinementMethod = refinement
    kinds = [getattr(cv2.aruco, f"DICT_{kind}") for kind in _KINDS]
    return cv2.aruco.ArucoDetector([*map(cv2.aruco.getPredefinedDictionary, kinds)], settings)


def _markers(grey: np.ndarray, refinement: int) -> list[tuple[str, np.ndarray]]:
    corners, numbers, _, kinds = _detector(refinement).detectMarkersMultiDict(grey)
    rows = zip(corners, np.ravel(kinds), np.ravel(numbers), strict=False)  # None without markers
    return [(f"{_KINDS[int(kind)]}:{n}", at[0].astype(np.float64)) for at, kind, n in rows]
