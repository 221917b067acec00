"""The panels that the figures are made of. Each draws one thing on the axes it is given.

Axes are in original pixels, (0, 0) the centre of the top-left one; large images are shrunk to what
a figure can show.
"""

from __future__ import annotations

import cv2
import numpy as np
from matplotlib.axes import Axes
from matplotlib.cm import ScalarMappable
from matplotlib.collections import LineCollection
from matplotlib.colors import Normalize

from dgc_pose.image import resize
from dgc_pose.pixels import rescale

SHOWN_SIDE = 800  # longest side of an image in a figure, pixels
CONFIDENCE_COLOURS = "viridis"
LINE_COLOURS = "hsv"


def show_image(axes: Axes, pixels: np.ndarray, title: str = "") -> None:
    """Draw an image (H, W, 3) uint8 RGB."""
    _show(axes, _shrunk(pixels), _size(pixels), title)


def show_matches(
    axes: Axes,
    pixels1: np.ndarray,
    pixels2: np.ndarray,
    points1: np.ndarray,
    points2: np.ndarray,
    confidence: np.ndarray,
    title: str = "",
) -> ScalarMappable:
    """Draw two images side by side at one height, a line for each match, coloured by confidence.

    Points are (N, 2) pixels of their own image. Returns what a colour bar needs.
    """
    (width1, height1), (width2, height2) = _size(pixels1), _size(pixels2)
    scale = height1 / height2
    left = 1.02 * width1 - 0.5  # edge of image 2, beyond a gap of 2 %
    right = left + scale * width2
    for pixels, edges in ((pixels1, (-0.5, width1 - 0.5)), (pixels2, (left, right))):
        axes.imshow(_shrunk(pixels), extent=(*edges, height1 - 0.5, -0.5), interpolation="bilinear")
    shifted = (points2 + 0.5) * scale + (left, -0.5)
    colours = ScalarMappable(Normalize(0, 1), CONFIDENCE_COLOURS)
    lines = np.stack([points1, shifted], axis=1)
    shades = colours.to_rgba(confidence)
    axes.add_collection(LineCollection(list(lines), colors=shades, linewidths=0.8, alpha=0.8))
    for ends in (points1, shifted):
        axes.scatter(ends[:, 0], ends[:, 1], s=6, c=shades, linewidths=0)
    _frame(axes, (right + 0.5, height1), title)
    return colours


def show_points(axes: Axes, points: np.ndarray) -> None:
    """Mark points (N, 2), each in its own colour, which is that of its line by `show_lines`."""
    colours = _line_colours(len(points))
    axes.scatter(points[:, 0], points[:, 1], s=28, c=colours, edgecolors="white", linewidths=0.8)


def show_lines(axes: Axes, lines: np.ndarray) -> None:
    """Draw lines (N, 3), a x + b y + c = 0 in pixels, across axes whose limits are set."""
    for (a, b, c), colour in zip(lines, _line_colours(len(lines)), strict=True):
        norm = np.hypot(a, b)
        if norm == 0:
            continue  # the line at infinity: its point is the epipole
        foot = np.array([-a * c, -b * c]) / norm**2
        along = np.array([b, -a]) / norm
        axes.axline(tuple(foot), tuple(foot + along), color=colour, linewidth=1.2)


def show_matchability(
    axes: Axes, pixels2: np.ndarray, matchability: np.ndarray, title: str = ""
) -> ScalarMappable:
    """Draw the matchability (H', W') in [0, 1] over image 2. Returns what a colour bar needs."""
    grey = cv2.cvtColor(_shrunk(pixels2), cv2.COLOR_RGB2GRAY)
    colours = ScalarMappable(Normalize(0, 1), CONFIDENCE_COLOURS)
    shown = cv2.resize(matchability.astype(np.float32), grey.shape[::-1])
    shaded = colours.to_rgba(shown)[..., :3] * (0.35 + 0.65 * grey[..., None] / 255)
    _show(axes, shaded, _size(pixels2), title)
    return colours


def show_warp(
    axes: Axes,
    pixels1: np.ndarray,
    correspondences: np.ndarray,
    matchability: np.ndarray,
    size2: tuple[int, int],
    title: str = "",
) -> None:
    """Draw image 1 warped onto image 2, paler where it is less matchable.

    Args:
        pixels1: (H, W, 3) uint8.
        correspondences: (H', W', 2), for each cell of image 2's grid its point in image 1, pixels.
        matchability: (H', W') in [0, 1].
        size2: width and height of image 2, pixels.
    """
    warped = warp_image(pixels1, correspondences, _shown_size(size2))
    weight = np.clip(cv2.resize(matchability.astype(np.float32), warped.shape[1::-1]), 0, 1)
    paled = 255 - (0.15 + 0.85 * weight[..., None]) * (255 - warped.astype(np.float32))
    _show(axes, paled.astype(np.uint8), size2, title)


def show_colour_bar(axes: Axes, colours: ScalarMappable, label: str) -> None:
    """A colour bar to the right of the axes, as high as what they show."""
    bar = axes.inset_axes((1.01, 0.0, 0.012, 1.0))
    axes.figure.colorbar(colours, cax=bar, label=label)


def warp_image(
    pixels1: np.ndarray, correspondences: np.ndarray, size: tuple[int, int]
) -> np.ndarray:
    """Image 1 sampled at the points (H', W', 2) of a map that is resized to (width, height).

    White outside image 1. Returns (height, width, 3) uint8.
    """
    source = _shrunk(pixels1)
    points = cv2.resize(correspondences.astype(np.float32), size)
    x, y = np.moveaxis(rescale(points, _size(pixels1), _size(source)).astype(np.float32), -1, 0)
    white = (255, 255, 255)
    return cv2.remap(
        source, x, y, cv2.INTER_LINEAR, borderMode=cv2.BORDER_CONSTANT, borderValue=white
    )


def _size(pixels: np.ndarray) -> tuple[int, int]:
    return pixels.shape[1], pixels.shape[0]


def _shown_size(size: tuple[int, int]) -> tuple[int, int]:
    scale = min(1.0, SHOWN_SIDE / max(size))
    return max(1, round(size[0] * scale)), max(1, round(size[1] * scale))


def _shrunk(pixels: np.ndarray) -> np.ndarray:
    return resize(pixels, _shown_size(_size(pixels)))


def _show(axes: Axes, picture: np.ndarray, size: tuple[float, float], title: str) -> None:
    """Draw a picture over all of an image of `size` (width, height)."""
    extent = (-0.5, size[0] - 0.5, size[1] - 0.5, -0.5)
    axes.imshow(picture, extent=extent, interpolation="bilinear")
    _frame(axes, size, title)


def _frame(axes: Axes, size: tuple[float, float], title: str) -> None:
    """Fix the axes to an image of this size, so that nothing drawn later moves them."""
    xlim, ylim = (-0.5, size[0] - 0.5), (size[1] - 0.5, -0.5)
    axes.set(xlim=xlim, ylim=ylim, aspect="equal", xticks=[], yticks=[])
    axes.set_title(title, fontsize=10)


def _line_colours(count: int) -> np.ndarray:
    shades = ScalarMappable(Normalize(0, max(count, 1)), LINE_COLOURS)
    return shades.to_rgba(np.arange(count))
