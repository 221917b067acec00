"""The panels that the figures are made of. Each draws one thing on axes of the caller.

Axes are in original pixels, (0, 0) the centre of the top-left one; large images are shrunk to what
a figure can show. What is drawn later, such as points on an image, does not move the axes.
"""

from collections.abc import Sequence

import cv2
import numpy as np
from matplotlib.axes import Axes
from matplotlib.cm import ScalarMappable
from matplotlib.collections import LineCollection
from matplotlib.colors import Normalize
from matplotlib.patheffects import withStroke

from dgc_pose.scene import shown_size, shrunk, warp_image

Pair = tuple[float, float]
_GAP = 0.02  # between the two images of `draw_matches`, as a share of the width of image 1
_WIDE = 4.0  # sum of the images' width over height: from there on image 2 stands below image 1
_HALO = [withStroke(linewidth=1.6, foreground="black", alpha=0.5)]  # of lines, for bright images


def draw_image(axes: Axes, pixels: np.ndarray) -> None:
    """Draw an image (H, W, 3) uint8 RGB."""
    _show(axes, shrunk(pixels), pixels.shape[1::-1])


def draw_matches(
    axes: Axes,
    pixels1: np.ndarray,
    pixels2: np.ndarray,
    points1: np.ndarray,
    points2: np.ndarray,
    values: np.ndarray,
    *,
    colours: ScalarMappable | None = None,
) -> ScalarMappable:
    """Draw two images side by side at one height, or wide ones one above the other, and a line for
    each match.

    pixels1, pixels2: (H, W, 3) uint8 RGB. points1, points2: (N, 2) pixels of their own image.
    values: (N,), what the colour of a line stands for. colours: of the values; None for
    confidences, 0 to 1. See `residual_colours`.

    Returns what a colour bar needs.
    """
    left, top, right, bottom, scale = second_place(pixels1, pixels2)
    _show(axes, shrunk(pixels1), pixels1.shape[1::-1])
    _show(axes, shrunk(pixels2), (right, bottom), (left, top))
    colours = colours or ScalarMappable(Normalize(0, 1), "cool_r")
    shades = colours.to_rgba(values)
    lines = np.stack([points1, (points2 + 0.5) * scale + (left - 0.5, top - 0.5)], axis=1)
    drawn = LineCollection(list(lines), colors=shades, linewidths=0.8, path_effects=_HALO)
    axes.add_collection(drawn)
    for ends in np.moveaxis(lines, 1, 0):
        axes.scatter(ends[:, 0], ends[:, 1], s=6, c=shades, linewidths=0)
    return colours


def second_place(pixels1: np.ndarray, pixels2: np.ndarray) -> tuple[float, ...]:
    """Where `draw_matches` has image 2: its left, upper, right and lower edge in pixels of image 1,
    of which the last two are the size of the whole; and its scale."""
    (height1, width1), (height2, width2) = pixels1.shape[:2], pixels2.shape[:2]
    scale, left, top = height1 / height2, (1 + _GAP) * width1, 0.0
    if width1 / height1 + width2 / height2 > _WIDE:
        scale, left, top = width1 / width2, 0.0, height1 + _GAP * width1
    return left, top, left + scale * width2, top + scale * height2, scale


def residual_colours(residuals: np.ndarray) -> ScalarMappable:
    """Colours from 0 to the 95 % quantile of the finite residuals (N,), for `draw_matches`."""
    finite = residuals[np.isfinite(residuals)]
    most = float(np.quantile(finite, 0.95)) if len(finite) else 1.0
    # Cyan to magenta: both stand out from a photograph, dark or light.
    return ScalarMappable(Normalize(0, max(most, 1e-3)), "cool")


def draw_points(axes: Axes, points: np.ndarray) -> None:
    """Mark points (N, 2), each in the colour of its curve by `draw_curves`."""
    colours = line_colours(len(points))
    axes.scatter(points[:, 0], points[:, 1], s=28, c=colours, edgecolors="white", linewidths=0.8)


def draw_curves(axes: Axes, curves: Sequence[np.ndarray]) -> None:
    """Draw curves (M, 2) in pixels, broken where they are NaN, on axes whose limits are set."""
    for curve, colour in zip(curves, line_colours(len(curves)), strict=True):
        axes.plot(*curve.T, color=colour, linewidth=1.2, scalex=False, scaley=False)


def draw_matchability(axes: Axes, pixels2: np.ndarray, matchability: np.ndarray) -> ScalarMappable:
    """Draw the matchability (H', W') in [0, 1] over image 2. Returns what a colour bar needs."""
    grey = cv2.cvtColor(shrunk(pixels2), cv2.COLOR_RGB2GRAY)
    colours = ScalarMappable(Normalize(0, 1), "viridis")
    shown = cv2.resize(matchability.astype(np.float32), grey.shape[::-1])
    shaded = colours.to_rgba(shown)[..., :3] * (0.35 + 0.65 * grey[..., None] / 255)
    _show(axes, shaded, pixels2.shape[1::-1])
    return colours


def draw_warp(
    axes: Axes,
    pixels1: np.ndarray,
    correspondences: np.ndarray,
    matchability: np.ndarray,
    size2: tuple[int, int],
) -> None:
    """Draw image 1 warped onto image 2, paler where it is less matchable.

    pixels1: (H, W, 3) uint8. correspondences: (H', W', 2), for each cell of image 2's grid its
    point in image 1, pixels. matchability: (H', W') in [0, 1]. size2: (width, height), pixels.
    """
    warped = warp_image(pixels1, correspondences, shown_size(size2))
    weight = np.clip(cv2.resize(matchability.astype(np.float32), warped.shape[1::-1]), 0, 1)
    paled = 255 - (0.15 + 0.85 * weight[..., None]) * (255 - warped.astype(np.float32))
    _show(axes, paled.astype(np.uint8), size2)


def _show(axes: Axes, picture: np.ndarray, end: Pair, start: Pair = (0.0, 0.0)) -> None:
    """Draw a picture between two corners, and fix the axes to (0, 0) and the second, so that
    nothing drawn later moves them."""
    (left, top), (right, bottom) = np.subtract((start, end), 0.5).tolist()
    axes.imshow(picture, extent=(left, right, bottom, top))
    axes.set(xlim=(-0.5, right), ylim=(bottom, -0.5), aspect="equal", xticks=[], yticks=[])


def line_colours(count: int) -> np.ndarray:
    """Colours (N, 4) of as many lines or cameras, around the circle of hues."""
    shades = ScalarMappable(Normalize(0, max(count, 1)), "hsv")
    return shades.to_rgba(np.arange(count))
