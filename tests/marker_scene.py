"""Printed markers in posed pictures: each drawn by its homography, with blur and noise."""

from collections.abc import Sequence

import cv2
import numpy as np
from scenes import project
from scipy.spatial.transform import Rotation

_SUPERSAMPLED = 4
_CELL = 20  # pixels of a marker's cell before it is projected


def square(side: float, middle: Sequence[float], tilt: Sequence[float] = (0, 0, 0)) -> np.ndarray:
    """Corners (4, 3) of a marker, clockwise from its top left; without a tilt it faces -z."""
    flat = np.array([[-1, -1, 0], [1, -1, 0], [1, 1, 0], [-1, 1, 0]]) * side / 2
    turned: np.ndarray = flat @ Rotation.from_rotvec(tilt).as_matrix().T + middle
    return turned


def pixels_of(K: np.ndarray, pose: np.ndarray, points: np.ndarray) -> np.ndarray:
    """Pixels (N, 2) of points (N, 3) for a camera with K and cam_from_world [R | t]."""
    return project(points, K, pose[:, :3], pose[:, 3])


def draw_markers(
    image: np.ndarray,
    K: np.ndarray,
    pose: np.ndarray,
    markers: dict[str, np.ndarray],
    seed: int = 0,
) -> np.ndarray:
    """A grey image (H, W) uint8 with markers, which have the names of `find_markers` and corners
    (4, 3) in the world."""
    height, width = image.shape
    size = (_SUPERSAMPLED * width, _SUPERSAMPLED * height)
    large = cv2.resize(image, size, interpolation=cv2.INTER_CUBIC)
    for name, corners in markers.items():
        kind, number = name.split(":")
        dictionary = cv2.aruco.getPredefinedDictionary(getattr(cv2.aruco, f"DICT_{kind}"))
        side = (dictionary.markerSize + 2) * _CELL
        drawn = cv2.aruco.generateImageMarker(dictionary, int(number), side)
        drawn = cv2.copyMakeBorder(drawn, *[_CELL] * 4, cv2.BORDER_CONSTANT, value=255)
        low, high = _CELL - 0.5, _CELL + side - 0.5  # edges, (0, 0) a pixel's centre
        source = np.array([[low, low], [high, low], [high, high], [low, high]], np.float32)
        target = (pixels_of(K, pose, corners) + 0.5) * _SUPERSAMPLED - 0.5
        H = cv2.getPerspectiveTransform(source, target.astype(np.float32))
        inside = cv2.warpPerspective(np.full_like(drawn, 255), H, size) > 127
        large = np.where(inside, cv2.warpPerspective(drawn, H, size), large)
    small = cv2.resize(large, (width, height), interpolation=cv2.INTER_AREA).astype(float)
    noise = np.random.default_rng(seed).normal(0, 3, small.shape)
    pixels: np.ndarray = (cv2.GaussianBlur(small, (0, 0), 0.7) + noise).clip(0, 255)
    return pixels.astype(np.uint8)


def texture(size: tuple[int, int], seed: int = 0) -> np.ndarray:
    """A smooth random grey image of (width, height)."""
    rough = np.random.default_rng(seed).integers(60, 200, (size[1] // 8, size[0] // 8), np.uint8)
    return cv2.resize(rough, size, interpolation=cv2.INTER_CUBIC)
