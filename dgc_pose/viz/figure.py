"""Parts of figures, by matplotlib's object interface: without pyplot, so without global state.

A function `draw_...` draws one thing on the caller's axes, in original pixels; (0, 0) is the centre
of the top-left pixel. Large images are shrunk to the resolution of a figure. Later drawings, such
as points on an image, do not move the axes.
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

# Formats that matplotlib writes without other programs.
_FORMATS = ("png", "jpg", "jpeg", "webp", "tif", "tiff", "svg", "pdf", "eps")
WIDTH = 10.0  # of a figure, inches
SHOWN_SIDE = 1200  # longest side of a drawn image, pixels
Pair = tuple[float, float]
_GAP = 0.02  # between the two images of `draw_matches`, as a share of the width of image 1
_WIDE = 4.0  # above this sum of the images' width over height, image 2 is below image 1
_HALO = [withStroke(linewidth=1.6, foreground="black", alpha=0.5)]  # of lines, for bright images


def new_figure(width: float, height: float) -> Figure:
    """An empty figure with its canvas and a constrained layout, sizes in inches."""
    figure = Figure(figsize=(width, height), layout="constrained")
    FigureCanvasAgg(figure)
    return figure


def picture_format(path: str | Path) -> str:
    """The format from the ending of a file name. Raises InputError if it is not supported."""
    suffix = Path(path).suffix.lower().lstrip(".")
    if suffix not in _FORMATS:
        raise InputError(f"{path}: a plot is written as one of {', '.join(_FORMATS)}")
    return suffix


def save_figure(figure: Figure, path: str | Path, dpi: float = 200) -> None:
    """Write the figure in the format of the path's ending (see `picture_format`).

    dpi: pixels per inch. Titles and legends are not parsed as formulas, since they may contain file
    names. Raises OSError, with the path.
    """
    for axes in figure.axes:
        legend = axes.get_legend()
        for text in (axes.title, *axes.texts, *(legend.get_texts() if legend else ())):
            text.set_parse_math(False)
            text.set_text(text.get_text().encode("utf-8", "replace").decode())
    with naming_path(path):
        figure.savefig(path, format=picture_format(path), dpi=dpi)


def shrunk(pixels: np.ndarray) -> np.ndarray:
    """Shrink an image (H, W, 3) to at most `SHOWN_SIDE` pixels a side."""
    return resize_by(pixels, min(1.0, SHOWN_SIDE / max(pixels.shape[:2])))


def warp_image(pixels1: np.ndarray, correspondences: np.ndarray, size2: Size) -> np.ndarray:
    """Warp image 1 onto image 2 of size (width, height), by its points (H', W', 2) in image 1.

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
    """Draw two images side by side with equal height, or wide ones one above the other, and a line
    for each match.

    pixels1, pixels2: (H, W, 3) uint8 RGB. points1, points2: (N, 2) pixels, each in its image.
    values: (N,), shown by the colours of the lines. colours: of the values, see
    `residual_colours`; None for confidences, 0 to 1. Returns the mappable for a colour bar.
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
    """The place of image 2 in `draw_matches`: its left, upper, right and lower edge in pixels of
    image 1, and its scale. The right and lower edge are the size of the whole drawing."""
    height1, width1 = pixels1.shape[:2]
    height2, width2 = pixels2.shape[:2]
    scale = height1 / height2
    left = (1 + _GAP) * width1
    top = 0.0
    if width1 / height1 + width2 / height2 > _WIDE:
        scale = width1 / width2
        left = 0.0
        top = height1 + _GAP * width1
    return left, top, left + scale * width2, top + scale * height2, scale


def residual_colours(residuals: np.ndarray) -> ScalarMappable:
    """Colours from 0 to the 95 % quantile of the finite residuals (N,), for `draw_matches`."""
    finite = residuals[np.isfinite(residuals)]
    most = float(np.quantile(finite, 0.95)) if len(finite) else 1.0
    # Cyan and magenta stand out from dark and bright photographs.
    return ScalarMappable(Normalize(0, max(most, 1e-3)), "cool")


def draw_points(axes: Axes, points: np.ndarray) -> None:
    """Mark points (N, 2), each in the colour of its curve in `draw_curves`."""
    colours = line_colours(len(points))
    axes.scatter(points[:, 0], points[:, 1], s=28, c=colours, edgecolors="white", linewidths=0.8)


def draw_curves(axes: Axes, curves: Sequence[np.ndarray]) -> None:
    """Draw curves (M, 2), pixels, with gaps at NaN, on axes with fixed limits."""
    for curve, colour in zip(curves, line_colours(len(curves)), strict=True):
        axes.plot(*curve.T, color=colour, linewidth=1.2, scalex=False, scaley=False)


def draw_matchability(axes: Axes, pixels2: np.ndarray, matchability: np.ndarray) -> ScalarMappable:
    """Draw matchability (H', W') in [0, 1] over image 2; return the mappable for a colour bar."""
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

    pixels1: (H, W, 3) uint8. correspondences: (H', W', 2), the point in image 1, pixels, for each
    cell of image 2's grid. matchability: (H', W') in [0, 1]. size2: (width, height), pixels.
    """
    warped = warp_image(pixels1, correspondences, size2)
    weight = np.clip(cv2.resize(matchability.astype(np.float32), warped.shape[1::-1]), 0, 1)
    paled = 255 - (0.15 + 0.85 * weight[..., None]) * (255 - warped.astype(np.float32))
    _show(axes, paled.astype(np.uint8), size2)


def _show(axes: Axes, picture: np.ndarray, end: Pair, start: Pair = (0.0, 0.0)) -> None:
    """Draw a picture from `start` to `end`, and fix the axes from (0, 0) to `end`, so that later
    drawings do not move them."""
    (left, top), (right, bottom) = np.subtract((start, end), 0.5).tolist()
    axes.imshow(picture, extent=(left, right, bottom, top))
    axes.set(xlim=(-0.5, right), ylim=(bottom, -0.5), aspect="equal", xticks=[], yticks=[])


def line_colours(count: int) -> np.ndarray:
    """Colours (N, 4) for `count` lines or cameras, around the circle of hues."""
    shades = ScalarMappable(Normalize(0, max(count, 1)), "hsv")
    return shades.to_rgba(np.arange(count))
