"""Image 1 as a map warps it, at a size that can be shown."""

import cv2
import numpy as np

from dgc_pose.geometry.pixels import Size, rescale
from dgc_pose.images.image import resize

SHOWN_SIDE = 1600  # longest side of an image that is shown, pixels


def warp_image(pixels1: np.ndarray, correspondences: np.ndarray, size: Size) -> np.ndarray:
    """Image 1 sampled at the points (H', W', 2) of a map that is resized to (width, height).

    White outside image 1. Returns (height, width, 3) uint8.
    """
    source = shrunk(pixels1)
    whole, small = pixels1.shape[1::-1], source.shape[1::-1]
    points = cv2.resize(correspondences.astype(np.float32), size)
    x, y = np.moveaxis(rescale(points, whole, small).astype(np.float32), -1, 0)
    white = (255, 255, 255)
    return cv2.remap(
        source, x, y, cv2.INTER_LINEAR, borderMode=cv2.BORDER_CONSTANT, borderValue=white
    )


def shown_size(size: Size) -> Size:
    """(width, height) with the longest side at most `SHOWN_SIDE`."""
    scale = min(1.0, SHOWN_SIDE / max(size))
    return max(1, round(size[0] * scale)), max(1, round(size[1] * scale))


def shrunk(pixels: np.ndarray) -> np.ndarray:
    """An image (H, W, 3) at its `shown_size`."""
    return resize(pixels, shown_size((pixels.shape[1], pixels.shape[0])))
