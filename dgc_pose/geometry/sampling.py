"""Bilinear sampling of images at points between their pixels."""

import cv2
import numpy as np

_CHUNK = 30000  # rows at a time: cv2.remap makes no image with a side of 32768 or more


def bilinear(image: np.ndarray, points: np.ndarray) -> np.ndarray:
    """Values (N, P[, C]) of an image (H, W[, C]) at points (N, P, 2), its edge repeated."""
    return bilinear_at(image, points[..., 0], points[..., 1])


def bilinear_at(image: np.ndarray, x: np.ndarray, y: np.ndarray) -> np.ndarray:
    """As `bilinear`, of points by their coordinates, (N, P) each."""
    x, y = (np.ascontiguousarray(axis, np.float32) for axis in (x, y))
    values = np.empty((*x.shape, *image.shape[2:]), image.dtype)
    for i in range(0, len(x), _CHUNK):
        rows = slice(i, i + _CHUNK)
        values[rows] = cv2.remap(
            image, x[rows], y[rows], cv2.INTER_LINEAR, borderMode=cv2.BORDER_REPLICATE
        )
    return values
