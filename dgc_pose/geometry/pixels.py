"""Pixel coordinates under resizing. Pixel (0, 0) is the centre of the top-left pixel everywhere."""

import numpy as np
from numpy.typing import ArrayLike

Size = tuple[int, int]  # (width, height)


def rescale(points: np.ndarray, size: ArrayLike, other: ArrayLike) -> np.ndarray:
    """Points (..., 2) of an image of `size`, in the same image resized to `other`; (width, height).

    The half-pixel rule x' = (x + 0.5) s - 0.5: resizing keeps the outer edges of the image in
    place, not the centres of its outer pixels.
    """
    return (points + 0.5) * np.divide(other, size) - 0.5


def same_shape(size: Size, other: Size) -> bool:
    """Whether two sizes, of any scale, have one aspect ratio, within a pixel."""
    return abs(size[0] * other[1] - size[1] * other[0]) <= max(*size, *other)


def pixel_grid(size: Size) -> np.ndarray:
    """The pixels (H, W, 2) float64 of an image of size (width, height): x and y of each."""
    x, y = np.meshgrid(np.arange(size[0], dtype=np.float64), np.arange(size[1], dtype=np.float64))
    return np.stack([x, y], -1)


def cell_centres(cells: Size, size: ArrayLike) -> np.ndarray:
    """Centres (H, W, 2) float64 of a grid of `cells` (columns, rows) over an image of `size`."""
    return rescale(pixel_grid(cells), cells, size)


def within(points: np.ndarray, size: Size) -> np.ndarray:
    """Which of the points (..., 2) lie on an image of size (width, height): (...) bool."""
    return np.all((points > -0.5) & (points < np.subtract(size, 0.5)), axis=-1)
