"""A reconstruction from above and from the front: camera positions, viewing directions, points."""

from collections.abc import Sequence

import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure

from dgc_pose.geometry.rotation import aligning_rotation
from dgc_pose.viz.figure import new_figure

_SHOWN = 0.02  # share of the points at either end of an axis that does not count for the limits
_MOST = 20_000  # points drawn
_ARROW = 0.06  # length of a viewing direction, as a share of the figure's extent


def plot_reconstruction(
    poses: Sequence[np.ndarray], points: np.ndarray, colours: np.ndarray
) -> Figure:
    """Cameras and points, orthographic, in the mean camera's axes.

    poses: cam_from_world (3, 4), at least one. points: (N, 3), world. colours: (N, 3) uint8, RGB.
    """
    R, centres, axes = mean_axes(poses)
    chosen = np.linspace(0, len(points) - 1, min(_MOST, len(points))).astype(int)
    dots, cameras, directions = points[chosen] @ axes.T, centres @ axes.T, R[:, 2] @ axes.T
    figure = new_figure(12, 6, layout="compressed")
    above, front = figure.subplots(1, 2)
    above.set(title=f"from above: {len(poses)} cameras, {len(points)} points", ylabel="z")
    front.set(title="from the cameras", ylabel="-y")
    for panel, up, sign in ((above, 2, 1), (front, 1, -1)):  # the axis drawn upwards
        flat = [v[:, (0, up)] * np.array([1, sign]) for v in (dots, cameras, directions)]
        draw_cameras(panel, flat[0], flat[1], flat[2], colours[chosen] / 255)
    return figure


def mean_axes(poses: Sequence[np.ndarray]) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Rotations (N, 3, 3) and positions (N, 3) of cam_from_world poses, and the axes (3, 3) of the
    mean camera, in rows: the mean rotation, of least sum of |R_k - axes|^2."""
    R = np.stack([pose[:, :3] for pose in poses])
    centres = np.stack([-pose[:, :3].T @ pose[:, 3] for pose in poses])
    axes = aligning_rotation(np.tile(np.eye(3), (len(R), 1)), R.transpose(0, 2, 1).reshape(-1, 3))
    return R, centres, axes


def draw_cameras(
    axes: Axes, dots: np.ndarray, cameras: np.ndarray, directions: np.ndarray, shades: np.ndarray
) -> None:
    """A view of points, cameras and their directions, (N, 2) each."""
    ends = np.quantile(dots, (_SHOWN, 1 - _SHOWN), axis=0) if len(dots) else cameras
    low, high = np.minimum(ends[0], cameras.min(0)), np.maximum(ends[-1], cameras.max(0))
    extent = float((high - low).max()) or 1.0
    axes.scatter(dots[:, 0], dots[:, 1], s=1.5, c=shades, linewidths=0)
    arrows = _ARROW * extent * directions
    axes.quiver(
        *cameras.T, *arrows.T, color="tab:red", angles="xy", scale_units="xy", scale=1, width=0.004
    )
    axes.plot(*cameras.T, "o", color="tab:red", markersize=3)
    room, middle = 0.55 * extent, (low + high) / 2
    xlim, ylim = zip(middle - room, middle + room, strict=True)
    axes.set(aspect="equal", xlim=xlim, ylim=ylim, xlabel="x")
