"""ArUco and AprilTag markers in an image, and in several images."""

from collections import Counter
from collections.abc import Mapping
from contextlib import suppress
from functools import cache
from pathlib import Path

import cv2
import numpy as np

from dgc_pose.errors import ArgumentName, ImageError, InputError
from dgc_pose.images.decoding import read_pixels
from dgc_pose.system.parallel import in_threads

MAX_SIDE = 3  # metres, of a printed marker: a larger number is in another unit
# The largest dictionary of each kind contains the markers of the smaller ones.
_KINDS = (
    *("4X4_1000", "5X5_1000", "6X6_1000", "7X7_1000", "ARUCO_ORIGINAL", "ARUCO_MIP_36h12"),
    *("APRILTAG_16h5", "APRILTAG_25h9", "APRILTAG_36h10", "APRILTAG_36h11"),
)
_SHOWN = 3  # images that an error names
_MARGIN = 0.4  # around a marker, as a share of its size, for fitting lines to its sides


def shared_markers(images: Mapping[str, np.ndarray | Path]) -> dict[str, dict[str, np.ndarray]]:
    """The markers in each image, by `find_markers`.

    images: by name, the pixels or the file; a file that cannot be read shows none. Raises
    InputError, naming `marker`, if no marker is in two images.
    """
    found = dict(zip(images, in_threads(_found_in, [*images.values()]), strict=True))
    if any(n > 1 for n in Counter(name for once, _ in found.values() for name in once).values()):
        return {image: once for image, (once, _) in found.items()}
    shown = {
        image: ", ".join([*sorted(once), *(f"{name} ({n} times)" for name, n in repeated.items())])
        for image, (once, repeated) in found.items()
    }
    message = f"finds no marker in two of the {len(images)} images"
    if any(shown.values()):
        first, *others = sorted(shown, key=lambda image: not shown[image])[:_SHOWN]
        rest = [f"{image} {shown[image] or 'none'}" for image in others]
        message = ", ".join([f"{message}: {first} shows {shown[first]}", *rest])
    raise InputError(ArgumentName("marker"), message)


def find_markers(pixels: np.ndarray) -> dict[str, np.ndarray]:
    """Find markers: their corners (4, 2), pixels, clockwise from the marker's top left, by
    dictionary and number, such as "APRILTAG_36h11:7". Skips a marker that appears twice.

    pixels: (H, W[, C]). Some detections are squares of a texture: only trust a marker that several
    images show.
    """
    return _once_and_repeated(pixels)[0]


def _found_in(image: np.ndarray | Path) -> tuple[dict[str, np.ndarray], dict[str, int]]:
    with suppress(ImageError):
        return _once_and_repeated(read_pixels(image) if isinstance(image, Path) else image)
    return {}, {}


def _once_and_repeated(pixels: np.ndarray) -> tuple[dict[str, np.ndarray], dict[str, int]]:
    """The markers of `find_markers`, and the number of appearances of those that it skips."""
    grey = pixels if pixels.ndim == 2 else pixels[:, :, 1]
    grey = cv2.normalize(grey, None, 0, 255, cv2.NORM_MINMAX, cv2.CV_8U)  # type: ignore[call-overload]
    rough = _markers(grey, cv2.aruco.CORNER_REFINE_NONE)
    count = Counter(name for name, _ in rough)
    found = {}
    for name, corners in rough:
        margin = _MARGIN * np.ptp(corners, axis=0).max()
        x, y = (corners.min(0) - margin).clip(0).astype(int)
        right, bottom = (corners.max(0) + margin).astype(int)
        # Lines along the sides avoid the bias of blurred corners, but are slow in a whole image.
        refined = dict(_markers(grey[y:bottom, x:right], cv2.aruco.CORNER_REFINE_APRILTAG))
        if name in refined and count[name] == 1:
            found[name] = refined[name] + (x, y) - 0.5  # there, (0, 0) is a pixel's corner
    return found, {name: number for name, number in count.items() if number > 1}


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
