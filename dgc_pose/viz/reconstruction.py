"""A reconstruction from above and from the front: cameras as frusta, their names, and points."""

from collections.abc import Sequence
from pathlib import Path
from typing import Any

import numpy as np
from matplotlib.axes import Axes
from matplotlib.collections import PolyCollection
from matplotlib.colors import to_rgba_array
from matplotlib.figure import Figure
from matplotlib.patheffects import withStroke
from matplotlib.transforms import Bbox
from mpl_toolkits.axes_grid1.anchored_artists import AnchoredSizeBar

from dgc_pose.cameras.camera import Camera
from dgc_pose.errors import printable, shortened
from dgc_pose.geometry.rotation import aligning_rotation
from dgc_pose.model import Model
from dgc_pose.scene import frustum
from dgc_pose.viz.figure import Panel, panel_rows
from dgc_pose.viz.panels import line_colours

_SHOWN = 0.02  # share of the points at either end of an axis that does not count for the limits
_MOST = 50_000  # points drawn
_NAMED = 15  # cameras with a name, at most
_FRUSTUM = 0.03, 0.12  # least and largest length of a frustum's edges, shares of half the width
_OUTLINE = (1, 2, 3, 4, 1, 0, 2, 3, 0, 4)  # all edges of a frustum, whose centre is 0
_BACKGROUND, _DARKEST = "0.08", 0.2  # black points stand out too
_HALO = [withStroke(linewidth=1.5, foreground=_BACKGROUND)]  # of names, before points


def plot_reconstruction(model: Model, unit: str = "") -> Figure:
    """Cameras and points, orthographic, in the mean camera's axes. The colours of the cameras are
    in the order of their names; a model in metres, "m", has a scale bar."""
    names = sorted(model.poses)
    cameras, axes = frusta([(model.cameras[name], model.poses[name]) for name in names])
    chosen = np.linspace(0, len(model.points) - 1, min(_MOST, len(model.points))).astype(int)
    dots, shades = model.points[chosen] @ axes.T, model.colours[chosen] / 255
    titles = f"from above: {len(names)} cameras, {len(model.points)} points", "from the front"
    figure, ((above, front),) = panel_rows([[Panel(1.25, title) for title in titles]])
    for panel, up, eye in ((above, 2, dots[:, 1]), (front, 1, -dots[:, 2])):
        order = np.argsort(eye)  # what is nearest to the viewer comes last
        view = dots[order][:, (0, up)], _DARKEST + (1 - _DARKEST) * shades[order]
        drawn = draw_cameras(panel, *view, cameras[..., (0, up)], [*line_colours(len(names))])
        _draw_names(panel, names, drawn)
        panel.set(facecolor=_BACKGROUND, xticks=[], yticks=[])
        if unit == "m":
            most = np.ptp(panel.get_xlim()) / 4
            length = max(s for n in range(-6, 7) for k in (1, 2, 5) if (s := k * 10.0**n) <= most)
            bar = length, f"{length:g} m", "lower left"
            panel.add_artist(AnchoredSizeBar(panel.transData, *bar, frameon=False, color="white"))
    return figure


def frusta(views: Sequence[tuple[Camera, np.ndarray]]) -> tuple[np.ndarray, np.ndarray]:
    """The centres and the corners of the images (N, 5, 3) of cameras with a size and their poses
    cam_from_world (3, 4), the edges 1 long, and the axes (3, 3) that they are in, in rows: to the
    right, up and ahead of the mean camera."""
    axes = mean_axes([pose for _, pose in views]) * np.array([[1], [-1], [1]])
    cameras = np.stack([frustum(c.K, c.size or (0, 0), pose) for c, pose in views]) @ axes.T
    edges = cameras[:, 1:] - cameras[:, :1]
    cameras[:, 1:] = cameras[:, :1] + edges / np.linalg.norm(edges, axis=2, keepdims=True)
    return cameras, axes


def mean_axes(poses: Sequence[np.ndarray]) -> np.ndarray:
    """The axes (3, 3) of the mean camera of cam_from_world poses (3, 4), in rows: of least sum of
    |R_k - axes|^2."""
    rows = np.stack(poses)[:, :, :3].transpose(0, 2, 1).reshape(-1, 3)
    return aligning_rotation(np.tile(np.eye(3), (len(poses), 1)), rows)


def draw_cameras(
    panel: Axes, dots: np.ndarray, shades: np.ndarray, cameras: np.ndarray, colours: Sequence[Any]
) -> np.ndarray:
    """Draw a view of points (N, 2) and `frusta` (M, 5, 2), with their colours. Returns the frusta
    as they are drawn."""
    centres = cameras[:, 0]
    ends = np.quantile(dots, (_SHOWN, 1 - _SHOWN), axis=0) if len(dots) else centres
    low, high = np.minimum(ends[0], centres.min(0)), np.maximum(ends[-1], centres.max(0))
    shape = np.array([panel.bbox.width / panel.bbox.height, 1])
    half, middle = 0.6 * (np.max((high - low) / shape) or 1.0) * shape, (low + high) / 2
    xlim, ylim = zip(middle - half, middle + half, strict=True)
    panel.set(xlim=xlim, ylim=ylim, aspect="equal")
    panel.scatter(dots[:, 0], dots[:, 1], s=2.5, c=shades, linewidths=0)
    apart = np.median(np.linalg.norm(centres - np.median(centres, axis=0), axis=1))
    size = np.clip(2 * apart / len(centres) ** 0.5, *np.multiply(_FRUSTUM, half[0]))
    drawn: np.ndarray = cameras[:, :1] + size * (cameras - cameras[:, :1])
    faces = to_rgba_array(colours, 0.25)
    outlines = [camera[[*_OUTLINE]] for camera in drawn]
    panel.add_collection(PolyCollection(outlines, edgecolors=colours, facecolors=faces))
    return drawn


def _draw_names(panel: Axes, names: Sequence[str], cameras: np.ndarray) -> None:
    """Write names below their frusta, of every so many; none over another name or a camera."""
    boxes: list[Bbox] = []
    centres = panel.transData.transform(cameras[:, 0])
    for camera, name in [*zip(cameras, names, strict=True)][:: -(-len(names) // _NAMED)]:
        place = np.mean([camera.min(0)[0], camera.max(0)[0]]), camera.min(0)[1]
        text = panel.text(*place, shortened(printable(Path(name).name), 16), parse_math=False)
        text.set(ha="center", va="top", fontsize=7, color="white", path_effects=_HALO)
        box = text.get_window_extent()
        text.set_visible(not (box.count_overlaps(boxes) or box.count_contains(centres)))
        boxes += [box] * text.get_visible()
