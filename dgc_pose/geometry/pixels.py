"""Pixel coordinates under resizing. Pixel (0, 0) is the centre of the top-left pixel everywhere."""

import numpy as np
from numpy.typing import ArrayLike

Size = tuple[int, int]  # (width, height)
EXCHANGING = range(5, 9)  # EXIF orientations that exchange width and height


def exif_turn(orientation: int) -> np.ndarray:
    """The rotation or reflection (2, 2) from pixels as stored to the upright image for an EXIF
    orientation, 1 to 8: x' = turn @ x plus an offset. The transpose undoes it."""
    # From the stored sides that become the upper and the left one (EXIF 2.3, 4.6.4).
    signs = np.array(
        [-1 if orientation in (2, 3, 6, 7) else 1, -1 if orientation in (3, 4, 7, 8) else 1]
    )
    return np.diag(signs)[:, :: -1 if orientation in EXCHANGING else 1].astype(np.float64)


def turn_points(points: np.ndarray, turn: np.ndarray, size: Size) -> np.ndarray:
    """Points (..., 2) of an image of `size`, in the image after this `exif_turn`."""
    return points @ turn.T + (np.abs(turn) - turn) @ (np.array(size) - 1) / 2


def rescale(points: np.ndarray, size: ArrayLike, other: ArrayLike) -> np.ndarray:
    """Points (..., 2) of an image of `size`, in the same image resized to `other`; (width, height).

    The half-pixel rule x' = (x + 0.5) s - 0.5: resizing keeps the outer edges of the image in
    place, not the centres of its outer pixels.
    """
    return (points + 0.5) * np.divide(other, size) - 0.5


def same_shape(size: Size, other: Size) -> bool:
    """Whether two sizes, of any scale, have the same aspect ratio, within a pixel."""
    return abs(size[0] * other[1] - size[1] * other[0]) <= max(*size, *other)


def pixel_grid(size: Size) -> np.ndarray:
    """The pixels (H, W, 2) float64 of an image of size (width, height): x and y of each."""
    x, y = np.meshgrid(np.arange(size[0], dtype=np.float64), np.arange(size[1], dtype=np.float64))
    return np.stack([x, y], -1)


def window_offsets(radius: int) -> np.ndarray:
    """The offsets (N, 2) float64, row by row, of a square window's cells from the middle cell."""
    return pixel_grid((2 * radius + 1, 2 * radius + 1)).reshape(-1, 2) - radius


def within(points: np.ndarray, size: Size) -> np.ndarray:
    """Which of the points (..., 2) lie on an image of size (width, height): (...) bool."""
    return np.all((points > -0.5) & (points < np.subtract(size, 0.5)), axis=-1)
