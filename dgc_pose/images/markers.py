"""ArUco and AprilTag markers in an image."""

from functools import cache

import cv2
import numpy as np

# The largest dictionary of each kind has the markers of the smaller ones.
_KINDS = (
    *("4X4_1000", "5X5_1000", "6X6_1000", "7X7_1000", "ARUCO_ORIGINAL", "ARUCO_MIP_36h12"),
    *("APRILTAG_16h5", "APRILTAG_25h9", "APRILTAG_36h10", "APRILTAG_36h11"),
)
_MARGIN = 0.4  # of a marker's size, around it, in which lines are fitted to its sides


def find_markers(pixels: np.ndarray) -> dict[str, np.ndarray]:
    """The corners of markers, (4, 2) pixels, clockwise from the one that is the marker's top left,
    by dictionary and number, such as "APRILTAG_36h11:7". A marker that is there twice is left out.

    pixels: (H, W[, C]). Some are no markers, as any texture has squares: a marker is one that
    several images show.
    """
    grey = pixels if pixels.ndim == 2 else pixels[:, :, 1]
    grey = cv2.normalize(grey, None, 0, 255, cv2.NORM_MINMAX, cv2.CV_8U)  # type: ignore[call-overload]
    squares, numbers, _, kinds = _detector(_KINDS).detectMarkersMultiDict(grey)
    kinds = [] if numbers is None else [_KINDS[kind] for kind in np.ravel(kinds)]
    names = [f"{kind}:{number}" for kind, number in zip(kinds, np.ravel(numbers), strict=False)]
    found = {}
    for square, kind, name in zip(squares, kinds, names, strict=True):
        low, high = square[0].min(0), square[0].max(0)
        margin = _MARGIN * (high - low).max()
        x, y = np.maximum(low - margin, 0).astype(int)
        right, bottom = (high + margin).astype(int)
        # By lines along the sides, which have no bias of blurred corners: slow in a whole image.
        refiner = _detector((kind,), cv2.aruco.CORNER_REFINE_APRILTAG)
        refined, again, _ = refiner.detectMarkers(grey[y:bottom, x:right])
        at = {f"{kind}:{n}": of[0] for n, of in zip(np.ravel(again), refined, strict=False)}
        if name in at and names.count(name) == 1:
            found[name] = at[name].astype(np.float64) + (x, y) - 0.5  # (0, 0) is a corner there
    return found


@cache
def _detector(
    kinds: tuple[str, ...], refinement: int = cv2.aruco.CORNER_REFINE_NONE
) -> cv2.aruco.ArucoDetector:
    settings = cv2.aruco.DetectorParameters()
    settings.cornerRefinementMethod = refinement
    numbers = [getattr(cv2.aruco, f"DICT_{kind}") for kind in kinds]
    return cv2.aruco.ArucoDetector([*map(cv2.aruco.getPredefinedDictionary, numbers)], settings)
