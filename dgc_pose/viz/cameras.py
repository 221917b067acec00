"""Both cameras of a pose and the points between them, in three dimensions."""

import numpy as np
from mpl_toolkits.mplot3d import Axes3D
from mpl_toolkits.mplot3d.art3d import Line3DCollection

from dgc_pose.cameras.camera import Camera
from dgc_pose.errors import InputError
from dgc_pose.geometry.epipolar import homogeneous

COLOURS = ("tab:blue", "tab:orange")  # of cameras 1 and 2
_DEPTH = 0.15  # of a camera's pyramid, as a share of the median depth of the points
_SHOWN = 0.95  # of the points: the farthest ones would shrink all others


def draw_cameras(
    axes: Axes3D,
    R: np.ndarray,
    t: np.ndarray,
    camera1: Camera,
    camera2: Camera,
    points: np.ndarray,
    colours: np.ndarray | None = None,
) -> None:
    """Draw two cameras as pyramids, and points, in camera 1's axes, its y axis downwards.

    axes: made with projection="3d". R, t: of the pose x2 = R x1 + t. camera1, camera2: their sizes
    give the pyramids' shapes; without a size, twice the principal point counts. points: (N, 3) in
    units of |t|, such as `Trace.points3d`; those behind camera 1, the farthest twentieth and those
    not finite are left out. colours: (N, 3) RGB in [0, 1]; None for
    grey.

    Raises InputError if the axes are not of three dimensions.
    """
    if not isinstance(axes, Axes3D):
        raise InputError('axes must be made with projection="3d"')
    ahead = np.isfinite(points).all(1) & (points[:, 2] > 0)
    far = np.quantile(points[ahead, 2], _SHOWN) if ahead.any() else 1.0
    shown = ahead & (points[:, 2] <= far)
    depth = _DEPTH * float(np.median(points[shown, 2])) if shown.any() else 0.3
    pyramids = [_pyramid(camera1, depth), (_pyramid(camera2, depth) - t) @ R]
    dots, *pyramids = map(_upright, (points[shown], *pyramids))
    for number, (pyramid, colour) in enumerate(zip(pyramids, COLOURS, strict=True), start=1):
        centre, rim = pyramid[0], pyramid[1:]
        edges = [*((centre, corner) for corner in rim), *zip(rim, np.roll(rim, -1, 0), strict=True)]
        axes.add_collection3d(Line3DCollection(edges, colors=colour, linewidths=1.5))
        axes.text(*centre, f" {number}", color=colour)
    axes.plot(*np.stack([pyramids[0][0], pyramids[1][0]]).T, color="black", linewidth=1)
    shades = "grey" if colours is None else colours[shown]
    axes.scatter(*dots.T, s=3, c=shades, linewidths=0, depthshade=False)
    drawn = np.concatenate([dots, *pyramids])
    room = 0.03 * np.ptp(drawn, axis=0).max()
    low, high = drawn.min(0) - room, drawn.max(0) + room
    axes.set(xlim=(low[0], high[0]), ylim=(low[1], high[1]), zlim=(low[2], high[2]))
    axes.set(xlabel="x", ylabel="z", zlabel="-y")
    axes.set_box_aspect(high - low)  # a unit is equally long along all axes
    axes.view_init(elev=25, azim=-75)


def _pyramid(camera: Camera, depth: float) -> np.ndarray:
    """The centre and the four corners (5, 3) of a camera's view at a depth, in its axes."""
    size = camera.size or 2 * camera.K[:2, 2] + 1
    corners = np.array([(0, 0), (1, 0), (1, 1), (0, 1)]) * size - 0.5
    rays = homogeneous(corners) @ np.linalg.inv(camera.K).T
    return np.vstack([np.zeros(3), depth * rays])


def _upright(points: np.ndarray) -> np.ndarray:
    """Points (N, 3) with matplotlib's z axis, which points up, along -y."""
    return points[:, (0, 2, 1)] * (1, 1, -1)
