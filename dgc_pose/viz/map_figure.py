"""Pictures of dense maps beside the truth."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from matplotlib.axes import Axes
from matplotlib.cm import ScalarMappable
from matplotlib.colors import Normalize
from matplotlib.figure import Figure

from dgc_pose.errors import InputError
from dgc_pose.viz.figure import new_figure
from dgc_pose.viz.panels import show_colour_bar, show_image, warp_image

ERROR_COLOURS = "magma"
_ROW = 3.0  # inches


@dataclass(frozen=True, eq=False)
class MapPicture:
    """One pair with its map and the errors, on the grid of the target."""

    title: str
    image1: np.ndarray  # (H1, W1, 3) uint8, the source
    image2: np.ndarray  # (H, W, 3) uint8, the target
    map: np.ndarray  # (H, W, 2), for each pixel of the target its point in the source, pixels
    errors: np.ndarray  # (H, W) pixels; infinite without truth


def plot_maps(pictures: Sequence[MapPicture], *, limit: float = 20.0) -> Figure:
    """A row a pair: source, target, the source warped by the map, and the error up to `limit`.

    Raises InputError if there are no pictures.
    """
    if not pictures:
        raise InputError("pictures must hold at least one pair")
    figure = new_figure(4 * _ROW + 0.8, len(pictures) * (_ROW + 0.3))
    rows = figure.subplots(len(pictures), 4, squeeze=False)
    for panels, picture in zip(rows, pictures, strict=True):
        height, width = picture.image2.shape[:2]
        show_image(panels[0], picture.image1, picture.title)
        show_image(panels[1], picture.image2, "target")
        warped = warp_image(picture.image1, picture.map, (width, height))
        show_image(panels[2], warped, "source, warped")
        show_colour_bar(panels[3], show_errors(panels[3], picture.errors, limit), "pixels")
    return figure


def show_errors(axes: Axes, errors: np.ndarray, limit: float) -> ScalarMappable:
    """Draw errors (H, W) in pixels, brightest from `limit` on, grey if not finite.

    Returns what a colour bar needs.
    """
    colours = ScalarMappable(Normalize(0, limit), ERROR_COLOURS)
    known = np.isfinite(errors)
    shown = colours.to_rgba(np.where(known, errors, 0.0))[..., :3]
    shown[~known] = 0.5
    show_image(axes, (255 * shown).round().astype(np.uint8), "error")
    return colours
