"""What figures are made of, by matplotlib's object interface: no pyplot, so no global state.

A function `draw_...` draws one thing on axes of the caller, in original pixels, (0, 0) the centre
of the top-left one. Large images are shrunk to what a figure can show. What is drawn later, such as
points on an image, does not move the axes.
"""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path

import cv2
import numpy as np
from matplotlib.axes import Axes
from matplotlib.backends.backend_agg import FigureCanvasAgg
from matplotlib.cm import ScalarMappable
from matplotlib.collections import LineCollection
from matplotlib.colors import Normalize
from matplotlib.figure import Figure
from matplotlib.patheffects import withStroke

from dgc_pose.errors import InputError
from dgc_pose.geometry.pixels import Size, rescale
from dgc_pose.images.image import resize_by
from dgc_pose.system.files import naming_path

# What matplotlib draws without other programs.
_FORMATS = ("png", "jpg", "jpeg", "webp", "tif", "tiff", "svg", "pdf", "eps")
WIDTH = 10.0  # of a figure, inches
SHOWN_SIDE = 1200  # longest side of an image that is shown, pixels
Pair = tuple[float, float]
_GAP = 0.02  # between the two images of `draw_matches`, as a share of the width of image 1
_WIDE = 4.0  # sum of the images' width over height: from there on image 2 stands below image 1
_HALO = [withStroke(linewidth=1.6, foreground="black", alpha=0.5)]  # of lines, for bright images


def new_figure(width: float, height: float) -> Figure:
    """An empty figure with its canvas and a constrained layout, sizes in inches."""
    figure = Figure(figsize=(width, height), layout="constrained")
    FigureCanvasAgg(figure)
    return figure


def picture_format(path: str | Path) -> str:
    """The format of a file name's ending. Raises InputError if no picture is written in it."""
    suffix = Path(path).suffix.lower().lstrip(".")
    if suffix not in _FORMATS:
        raise InputError(f"{path}: a plot is written as one of {', '.join(_FORMATS)}")
    return suffix


def save_figure(figure: Figure, path: str | Path, dpi: float = 200) -> None:
    """Write the figure in the format of the path's ending (see `picture_format`).

    dpi: pixels to an inch. Titles and legends are shown as they are: names of files may hold what
    would be a formula. Raises OSError, with the path.
    """
    for axes in figure.axes:
        legend = axes.get_legend()
        for text in (axes.title, *axes.texts, *(legend.get_texts() if legend else ())):
            text.set_parse_math(False)
            text.set_text(text.get_text().encode("utf-8", "replace").decode())
    with naming_path(path):
        figure.savefig(path, format=picture_format(path), dpi=dpi)


def shrunk(pixels: np.ndarray) -> np.ndarray:
    """An image (H, W, 3) of at most `SHOWN_SIDE` pixels a side."""
    return resize_by(pixels, min(1.0, SHOWN_SIDE / max(pixels.shape[:2])))


def warp_image(pixels1: np.ndarray, correspondences: np.ndarray, size2: Size) -> np.ndarray:
    """Image 1 sampled at the points (H', W', 2) of the map of an image 2 of (width, height) pixels.

    White outside image 1. Returns (H, W, 3) uint8, of at most `SHOWN_SIDE` pixels a side.
    """
    scale = min(1.0, SHOWN_SIDE / max(size2))
    points = cv2.resize(
        correspondences.astype(np.float32), [max(1, round(side * scale)) for side in size2]
    )
    source = shrunk(pixels1)
    points = rescale(points, pixels1.shape[1::-1], source.shape[1::-1])
    x, y = np.moveaxis(points.astype(np.float32), -1, 0)
    white = (255, 255, 255)
    return cv2.remap(
        source, x, y, cv2.INTER_LINEAR, borderMode=cv2.BORDER_CONSTANT, borderValue=white
    )


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
    warped = warp_image(pixels1, correspondences, size2)
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
