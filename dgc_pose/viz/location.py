"""The place of a query in a model: the cameras from above, and matches with database images."""

from dataclasses import replace
from pathlib import Path

import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from matplotlib.patches import Ellipse

from dgc_pose.images.image import load_image
from dgc_pose.localization.location import Location
from dgc_pose.model import Model
from dgc_pose.refinement.align import spread
from dgc_pose.viz.figure import WIDTH, new_figure
from dgc_pose.viz.panels import draw_matches
from dgc_pose.viz.reconstruction import draw_cameras, frusta

_DRAWN = 100  # matches with a database image
_QUANTILE_90 = 2.146  # deviations of a normal point in the plane, nine times in ten
_LEAST = 0.015  # of the extent: a smaller ellipse would not be seen


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
    pose, covariance = location.cam_from_world, location.covariance
    views = [(model.cameras[name], pose) for name, pose in model.poses.items()]
    if pose is not None and location.camera is not None:
        views.append((replace(location.camera, size=size), pose))
    cameras, axes = frusta(views)
    seen = model.points @ axes.T
    names, shades = [*model.poses], np.full((len(seen), 3), 0.7)
    colours = ["gray"] * len(names) + ["tab:blue"] * (len(views) - len(names))
    centres = draw_cameras(panel, seen[:, (0, 2)], shades, cameras[..., (0, 2)], colours)[:, 0]
    filled = centres[[names.index(m.name) for m in location.database_images if m.agrees]]
    panel.plot(*filled.T, "o", color="black", markersize=4, label="database images")
    if covariance is not None:
        flat = (axes @ covariance[3:, 3:] @ axes.T)[np.ix_([0, 2], [0, 2])]
        variances, vectors = np.linalg.eigh(flat)
        least = _LEAST * np.ptp(panel.get_xlim())
        width, height = np.maximum(2 * _QUANTILE_90 * np.sqrt(variances), least)
        angle = float(np.degrees(np.arctan2(vectors[1, 0], vectors[0, 0])))
        middle = float(centres[-1, 0]), float(centres[-1, 1])
        ellipse = Ellipse(middle, width, height, angle=angle, color="tab:blue", zorder=3)
        ellipse.set_label("the query, and its error")
        panel.add_patch(ellipse)
    panel.set(title="from above", xlabel="x", ylabel="z")
    panel.legend(loc="best", fontsize=8)
