"""Views: parts of an image, rotated and resized by a similarity, as input of the network."""

from __future__ import annotations

import math
from dataclasses import dataclass

import cv2
import numpy as np

from dgc_pose.geometry.pixels import Size, pixel_grid, rescale, within
from dgc_pose.images.image import Image, resize_by

# Outside the image: ImageNet's mean colour, which normalisation maps to zero, like padding.
_BORDER = (124, 116, 104)


@dataclass(frozen=True)
class View:
    """A window on an image, rotated and resized; hashable, so that caches take it as a key."""

    image: Image
    angle_deg: float  # rotation of the image, counter-clockwise as by `numpy.rot90`
    scale: float  # pixels of the view per pixel of the image
    centre: tuple[float, float]  # pixel of the image, x and y, at the centre of the view
    size: Size  # (width, height) of the view, pixels of the view

    @staticmethod
    def whole(image: Image, angle_deg: float = 0.0, scale: float = 1.0) -> View:
        width, height = image.size
        return View.window(image, image.size, ((width - 1) / 2, (height - 1) / 2), angle_deg, scale)

    @staticmethod
    def rotated(image: Image, angle_deg: float, side: float) -> View:
        """The whole of an image; if it is rotated, shrunk to an area of at most `side` x `side`
        pixels."""
        scale = min(1.0, side / math.sqrt(math.prod(image.size)))
        return View.whole(image, angle_deg, scale if angle_deg else 1.0)

    @staticmethod
    def window(
        image: Image, extent: Size, centre: tuple[float, float], angle_deg: float, scale: float
    ) -> View:
        """The smallest view that contains `extent` (width, height) of the image around a pixel."""
        cosine, sine = _cosine_sine(angle_deg)
        width = abs(extent[0] * cosine) + abs(extent[1] * sine)
        height = abs(extent[0] * sine) + abs(extent[1] * cosine)
        # Rounding errors must not add a pixel.
        sides = (max(1, math.ceil(side * scale - 1e-6)) for side in (width, height))
        return View(image, angle_deg, scale, centre, (next(sides), next(sides)))

    @property
    def matrix(self) -> np.ndarray:
        """The affine matrix (2, 3) float64 from pixels of the image to pixels of the view."""
        linear = similarity(self.angle_deg, self.scale)
        middle = (np.array(self.size) - 1) / 2
        return np.column_stack([linear, middle - linear @ self.centre])

    def to_view(self, points: np.ndarray, cells: Size | None = None) -> np.ndarray:
        """Points (..., 2) of the image, in pixels of the view, or in `cells` (columns, rows) of a
        grid over it."""
        matrix = self.matrix
        points = points @ matrix[:, :2].T + matrix[:, 2]
        return points if cells is None else rescale(points, self.size, cells)

    def to_image(self, points: np.ndarray, cells: Size | None = None) -> np.ndarray:
        """Points (..., 2) of the view, or of a grid of `cells` over it, in pixels of the image."""
        matrix = self.matrix
        points = points if cells is None else rescale(points, cells, self.size)
        return (points - matrix[:, 2]) @ np.linalg.inv(matrix[:, :2]).T

    def centres(self, cells: Size) -> np.ndarray:
        """Centres (H, W, 2) of a grid of `cells` over the view, in pixels of the image."""
        return self.to_image(pixel_grid(cells), cells)

    def pixels(self) -> np.ndarray:
        """The view as an image (height, width, 3) uint8: shrunk by area means, otherwise bilinear,
        with ImageNet's mean colour outside the image."""
        pixels = self.image.pixels
        size = self.image.size
        if self == View.whole(self.image, self.angle_deg) and self.angle_deg % 90 == 0:
            return np.ascontiguousarray(np.rot90(pixels, round(self.angle_deg / 90)))
        matrix = self.matrix
        if self.scale < 1:
            pixels = resize_by(pixels, self.scale)
            step = np.array([size[0] / pixels.shape[1], size[1] / pixels.shape[0]])
            # Half-pixel rule: the resized image's (u, v) is ((u + 0.5) step - 0.5) of the image.
            matrix = np.column_stack(
                [matrix[:, :2] * step, matrix[:, :2] @ (step / 2 - 0.5) + matrix[:, 2]]
            )
        return cv2.warpAffine(
            pixels, matrix, self.size, borderMode=cv2.BORDER_CONSTANT, borderValue=_BORDER
        )

    def mask(self, cells: Size) -> np.ndarray:
        """Which of `cells` (columns, rows) over the view have their centre on the image: (rows,
        columns) bool."""
        return within(self.centres(cells), self.image.size)

    def shows(self, points: np.ndarray) -> np.ndarray:
        """Which points (..., 2) lie on the image, and not on a masked pixel: (...) bool."""
        return within(points, self.image.size) & ~self.image.is_masked(points)


def similarity(angle_deg: float, scale: float) -> np.ndarray:
    """The matrix (2, 2), on pixels, of a scale and a counter-clockwise (`numpy.rot90`) rotation."""
    cosine, sine = _cosine_sine(angle_deg)
    # y points down, so a counter-clockwise rotation takes (1, 0) to (cos, -sin).
    return scale * np.array([[cosine, sine], [-sine, cosine]])


def _cosine_sine(angle_deg: float) -> tuple[float, float]:
    """The cosine and sine, exact for quarter turns."""
    quarters, rest = divmod(angle_deg, 90)
    cosine = math.cos(math.radians(rest))
    sine = math.sin(math.radians(rest))
    turns = ((cosine, sine), (-sine, cosine), (-cosine, -sine), (sine, -cosine))
    return turns[int(quarters) % 4]
