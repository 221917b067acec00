"""Pictures of dense maps beside the truth."""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from matplotlib.cm import ScalarMappable
from matplotlib.colors import Normalize
from matplotlib.figure import Figure

from dgc_pose.matching.warp import warp_image
from dgc_pose.viz.figure import Panel, panel_rows
from dgc_pose.viz.panels import draw_colour_bar, draw_image

ERROR_LIMIT = 20.0  # pixels; from there on an error is drawn at its brightest


@dataclass(frozen=True, eq=False)
class MapPicture:
    """A pair with its map and the errors, on the grid of the target."""

    title: str
    image1: np.ndarray  # (H1, W1, 3) uint8, the source
    image2: np.ndarray  # (H, W, 3) uint8, the target
    map: np.ndarray  # (H, W, 2), for each pixel of the target its point in the source, pixels
    errors: np.ndarray  # (H, W) pixels; infinite without truth


def plot_maps(pictures: Sequence[MapPicture]) -> Figure:
    """A row a pair: source, target, the source warped by the map, and the error, grey if it is not
    finite."""
    colours = ScalarMappable(Normalize(0, ERROR_LIMIT), "magma")
    panels = []
    for picture in pictures:
        images = (picture.image1, picture.image2)
        aspect1, aspect2 = (image.shape[1] / image.shape[0] for image in images)
        titles = ("target", "source, warped", "error")
        others = [Panel(aspect2, title, bar=title == "error") for title in titles]
        panels.append([Panel(aspect1, picture.title), *others])
    figure, rows = panel_rows(panels)
    for (source, target, warped, error), picture in zip(rows, pictures, strict=True):
        height, width = picture.image2.shape[:2]
        draw_image(source, picture.image1)
        draw_image(target, picture.image2)
        draw_image(warped, warp_image(picture.image1, picture.map, (width, height)))
        known = np.isfinite(picture.errors)
        shades = colours.to_rgba(np.where(known, picture.errors, 0.0))[..., :3]
        shades[~known] = 0.5
        draw_image(error, (255 * shades).round().astype(np.uint8))
        draw_colour_bar(error, colours, "px")
    return figure
