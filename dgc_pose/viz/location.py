"""The place of a photograph in a model: the cameras from above, and matches with references."""

from pathlib import Path

import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from matplotlib.patches import Ellipse

from dgc_pose.images.image import load_image
from dgc_pose.localization.location import Location
from dgc_pose.localization.model import PosedModel
from dgc_pose.refinement.align import spread
from dgc_pose.viz.figure import new_figure
from dgc_pose.viz.panels import draw_matches
from dgc_pose.viz.reconstruction import draw_cameras, mean_axes

_DRAWN = 100  # matches with a reference
_QUANTILE_90 = 2.146  # deviations of a normal point in the plane, nine times in ten
_LEAST = 0.015  # of the extent: a smaller ellipse would not be seen


def plot_location(model: PosedModel, photo: str, location: Location) -> Figure:
    """Draw cameras and points from above, in the mean camera's axes: the references filled, and the
    photograph with its error, nine times in ten; and matches with the two references of most
    inliers."""
    figure = new_figure(14, 7)
    grid = figure.add_gridspec(2, 2, width_ratios=(1, 1.2))
    _draw_place(figure.add_subplot(grid[:, 0]), model, location)
    place = f"the centre within {location.position_error_90 or 0:.2g}, nine times in ten"
    error = f"R within {location.rotation_error_90_deg or 0:.2f}°, {place}"
    figure.suptitle(f"{Path(photo).name}: {error if location.success else location.reason}")
    image = load_image(photo).oriented(location.camera.orientation if location.camera else 1)
    used = [reference for reference in location.references if reference.agrees]
    best = sorted(used or location.references, key=lambda r: -r.inliers.sum())[:2]
    for row, reference in enumerate(best):
        matches = reference.matches.subset(reference.inliers)
        drawn = matches.subset(spread(matches.points2, matches.confidence, image.size, _DRAWN))
        orientation = model.cameras[reference.name].orientation
        pixels = load_image(model.root / reference.name).oriented(orientation).pixels
        panel = figure.add_subplot(grid[row, 1])
        points = drawn.points1, drawn.points2
        draw_matches(panel, pixels, image.pixels, *points, drawn.confidence)
        count = f"{len(matches)} of {len(reference.matches)} matches agree"
        panel.set_title(f"{reference.name}: {count}")
    return figure


def _draw_place(panel: Axes, model: PosedModel, location: Location) -> None:
    pose, covariance = location.cam_from_world, location.covariance
    poses = [*model.poses.values(), *([] if pose is None else [pose])]
    R, centres, axes = mean_axes(poses)
    seen = np.concatenate([xyz for xyz, _ in model.points.values()] or [centres])
    dots, cameras, directions = ((v @ axes.T)[:, (0, 2)] for v in (seen, centres, R[:, 2]))
    draw_cameras(panel, dots, cameras, directions, np.full((len(dots), 3), 0.7))
    names = [*model.poses]
    filled = cameras[[names.index(r.name) for r in location.references if r.agrees]]
    panel.plot(*filled.T, "o", color="black", markersize=7, label="references")
    if covariance is not None:
        flat = (axes @ covariance[3:, 3:] @ axes.T)[np.ix_([0, 2], [0, 2])]
        variances, vectors = np.linalg.eigh(flat)
        least = _LEAST * np.ptp(panel.get_xlim())
        width, height = np.maximum(2 * _QUANTILE_90 * np.sqrt(variances), least)
        angle = float(np.degrees(np.arctan2(vectors[1, 0], vectors[0, 0])))
        middle = float(cameras[-1, 0]), float(cameras[-1, 1])
        ellipse = Ellipse(middle, width, height, angle=angle, color="tab:blue", zorder=3)
        ellipse.set_label("the photograph, and its error")
        panel.add_patch(ellipse)
    panel.set(title="from above", ylabel="z")
    panel.legend(loc="best")
