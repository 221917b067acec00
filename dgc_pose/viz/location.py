"""The place of a query in a model: the cameras from above, and matches with database images."""

from pathlib import Path

import numpy as np
from matplotlib.axes import Axes
from matplotlib.collections import PolyCollection
from matplotlib.colors import to_rgba_array
from matplotlib.figure import Figure
from matplotlib.patches import Ellipse

from dgc_pose.geometry.sampling import spread
from dgc_pose.images.image import load_image
from dgc_pose.localization.location import Location
from dgc_pose.model import Model
from dgc_pose.scene import frustum, mean_axes
from dgc_pose.viz.figure import WIDTH, new_figure
from dgc_pose.viz.panels import draw_matches

_DRAWN = 100  # matches with a database image
_QUANTILE_90 = 2.146  # deviations of a normal point in the plane, nine times in ten
_LEAST = 0.015  # of the extent: a smaller ellipse would not be seen
_FAR = 0.02  # share of the points at either end of an axis
_FRUSTUM, _MARGIN = 0.05, 0.1  # length of a frustum's longest edge, and the margin, of the extent


def plot_location(model: Model, query: str, location: Location) -> Figure:
    """Draw cameras and points from above, in the mean camera's axes: the database images that agree
    filled, and the query with its error, nine times in ten; and matches with the two of most
    inliers."""
    figure = new_figure(WIDTH, WIDTH / 2)
    grid = figure.add_gridspec(2, 2, width_ratios=(1, 1.2))
    image = load_image(query)
    _draw_place(figure.add_subplot(grid[:, 0]), model, location, image.size)
    both = location.rotation_error_90_deg or 0, location.position_error_90 or 0
    error = "R within {:.2f}°, centre within {:.2g}, nine times in ten if it is right".format(*both)
    figure.suptitle(f"{Path(query).name}: {error if location.success else location.reason}")
    used = [matched for matched in location.database_images if matched.agrees]
    best = sorted(used or location.database_images, key=lambda m: -m.inliers.sum())[:2]
    for row, matched in enumerate(best):
        matches = matched.matches.subset(matched.inliers)
        drawn = matches.subset(spread(matches.points2, matches.confidence, image.size, _DRAWN))
        pixels = load_image(model.root / matched.name).pixels
        panel = figure.add_subplot(grid[row, 1])
        draw_matches(panel, pixels, image.pixels, drawn.points1, drawn.points2, drawn.confidence)
        count = f"{len(matches)} of {len(matched.matches)} matches agree"
        panel.set_title(f"{matched.name}: {count}")
    return figure


def _draw_place(panel: Axes, model: Model, location: Location, size: tuple[int, int]) -> None:
    names, poses = [*model.poses], [*model.poses.values()]
    Ks = [model.cameras[name].K for name in names]
    sizes = [model.cameras[name].size or size for name in names]
    if location.cam_from_world is not None and location.camera is not None:
        poses, Ks = [*poses, location.cam_from_world], [*Ks, location.camera.K]
        sizes.append(size)
    to_right_and_ahead = mean_axes(poses)[[0, 2]]
    frusta = np.stack([*map(frustum, Ks, sizes, poses)]) @ to_right_and_ahead.T
    points = model.points @ to_right_and_ahead.T
    centres, edges = frusta[:, :1], frusta[:, 1:] - frusta[:, :1]
    # The points at either end of an axis, which may be far away, do not count for the limits.
    ends = np.quantile(points, (_FAR, 1 - _FAR), axis=0) if len(points) else np.zeros((0, 2))
    low, high = (of([*centres[:, 0], *ends], axis=0) for of in (np.min, np.max))
    extent = float((high - low).max()) or 1.0
    drawn = centres + _FRUSTUM * extent / np.abs(edges).max() * edges
    panel.scatter(points[:, 0], points[:, 1], s=2.5, color="0.7", linewidths=0)
    colours = ["gray"] * len(names) + ["tab:blue"] * (len(poses) - len(names))
    outlines = np.concatenate([centres, drawn, centres], axis=1)
    faces = to_rgba_array(colours, 0.25)
    panel.add_collection(PolyCollection([*outlines], edgecolors=colours, facecolors=faces))
    agree = [names.index(image.name) for image in location.database_images if image.agrees]
    panel.plot(*centres[agree, 0].T, "o", color="black", markersize=4, label="database images")
    if location.covariance is not None:
        flat = to_right_and_ahead @ location.covariance[3:, 3:] @ to_right_and_ahead.T
        variances, vectors = np.linalg.eigh(flat)
        width, height = np.maximum(2 * _QUANTILE_90 * np.sqrt(variances), _LEAST * extent)
        angle = float(np.degrees(np.arctan2(vectors[1, 0], vectors[0, 0])))
        middle = float(centres[-1, 0, 0]), float(centres[-1, 0, 1])
        ellipse = Ellipse(middle, width, height, angle=angle, color="tab:blue", zorder=3)
        ellipse.set_label("the query, and its error")
        panel.add_patch(ellipse)
    (left, bottom), (right, top) = low - _MARGIN * extent, high + _MARGIN * extent
    panel.set(xlim=(left, right), ylim=(bottom, top))
    panel.set_aspect("equal", adjustable="datalim")
    panel.set(title="from above", xlabel="x", ylabel="z")
    panel.legend(loc="best", fontsize=8)
