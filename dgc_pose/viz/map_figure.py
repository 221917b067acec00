"""Pictures of dense maps beside the truth."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from matplotlib.axes import Axes
from matplotlib.cm import ScalarMappable
from matplotlib.colors import Normalize
from matplotlib.figure import Figure

from dgc_pose.matching.warp import warp_image
from dgc_pose.viz.layout import Panel, panel_rows
from dgc_pose.viz.panels import draw_colour_bar, draw_image


@dataclass(frozen=True, eq=False)
class MapPicture:
    """A pair with its map and the errors, on the grid of the target."""

    title: str
    image1: np.ndarray  # (H1, W1, 3) uint8, the source
    image2: np.ndarray  # (H, W, 3) uint8, the target
    map: np.ndarray  # (H, W, 2), for each pixel of the target its point in the source, pixels
    errors: np.ndarray  # (H, W) pixels; infinite without truth


def plot_maps(pictures: Sequence[MapPicture], *, limit: float = 20.0) -> Figure:
    """A row a pair: source, target, the source warped by the map, and the error up to `limit`."""
    figure, rows = panel_rows([_panels(picture) for picture in pictures])
    for (source, target, warped, error), picture in zip(rows, pictures, strict=True):
        height, width = picture.image2.shape[:2]
        draw_image(source, picture.image1)
        draw_image(target, picture.image2)
        draw_image(warped, warp_image(picture.image1, picture.map, (width, height)))
        draw_colour_bar(error, draw_map_errors(error, picture.errors, limit), "px")
    return figure


def _panels(picture: MapPicture) -> list[Panel]:
    images = (picture.image1, picture.image2)
    aspect1, aspect2 = (image.shape[1] / image.shape[0] for image in images)
    return [
        Panel(aspect1, picture.title),
        Panel(aspect2, "target"),
        Panel(aspect2, "source, warped"),
        Panel(aspect2, "error", bar=True),
    ]


def draw_map_errors(axes: Axes, errors: np.ndarray, limit: float) -> ScalarMappable:
    """Draw errors (H, W) in pixels, brightest from `limit` on, grey if not finite.

    Returns what a colour bar needs.
    """
    colours = ScalarMappable(Normalize(0, limit), "magma")
    known = np.isfinite(errors)
    shown = colours.to_rgba(np.where(known, errors, 0.0))[..., :3]
    shown[~known] = 0.5
    draw_image(axes, (255 * shown).round().astype(np.uint8))
    return colours
