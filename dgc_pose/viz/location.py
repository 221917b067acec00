"""The place of a photograph in a model: the cameras from above, and matches with references."""

from pathlib import Path

import numpy as np
from matplotlib.figure import Figure
from matplotlib.patches import Ellipse

from dgc_pose.images.image import load_image
from dgc_pose.localization.location import Location, Reference
from dgc_pose.localization.model import PosedModel
from dgc_pose.refinement.align import spread
from dgc_pose.viz.figure import new_figure
from dgc_pose.viz.panels import draw_matches
from dgc_pose.viz.reconstruction import draw_cameras, mean_axes

_DRAWN = 100  # matches with a reference
_QUANTILE_90 = 2.146  # deviations of a normal point in the plane, nine times in ten
_LEAST = 0.012  # of the extent: a smaller ellipse would not be seen


def plot_location(model: PosedModel, photo: str, location: Location) -> Figure:
    """Draw the cameras from above, in the mean camera's axes, those of the references filled; the
    photograph's with its error, nine times in ten; and matches with the two references of most
    inliers."""
    R, centres, axes = mean_axes([*model.poses.values()])
    figure = new_figure(14, 7)
    grid = figure.add_gridspec(2, 2, width_ratios=(1, 1.2))
    above = figure.add_subplot(grid[:, 0])
    flat = [(v @ axes.T)[:, (0, 2)] for v in (centres, R[:, 2])]
    places = flat[0]
    title = f"{Path(photo).name}: {location.reason}"
    if location.R is not None and location.centre is not None and location.covariance is not None:
        place, towards = ((axes @ v)[[0, 2]] for v in (location.centre, location.R[2]))
        places = np.vstack([places, place])
        title = (
            f"{Path(photo).name}: R within {location.rotation_error_90_deg:.2f}°, the centre "
            f"within {location.position_error_90:.2g}, nine times in ten"
        )
    draw_cameras(above, places, flat[0], flat[1], np.full((len(places), 3), 0.7))
    used = [reference for reference in location.references if reference.agrees]
    names = list(model.poses)
    chosen = flat[0][[names.index(reference.name) for reference in used]]
    above.plot(*chosen.T, "o", color="black", markersize=7, label="references")
    if len(places) > len(centres) and location.covariance is not None:
        covariance = (axes @ location.covariance[3:, 3:] @ axes.T)[np.ix_([0, 2], [0, 2])]
        variances, directions = np.linalg.eigh(covariance)
        least = _LEAST * np.ptp(places, axis=0).max()
        width, height = np.maximum(2 * _QUANTILE_90 * np.sqrt(variances), least)
        angle = float(np.degrees(np.arctan2(directions[1, 0], directions[0, 0])))
        above.add_patch(Ellipse(tuple(place), width, height, angle=angle, color="tab:blue"))
        arrow = 0.12 * np.ptp(places, axis=0).max() * towards
        above.annotate("", place + arrow, place, arrowprops={"color": "tab:blue", "width": 2})
        above.plot(*place, "o", color="tab:blue", markersize=4, label="the photograph")
    above.set(title="from above", ylabel="z")
    above.legend(loc="best")
    figure.suptitle(title)
    image = load_image(photo, upright=True)
    best = sorted(used or location.references, key=lambda r: -r.inliers.sum())[:2]
    for row, reference in enumerate(best):
        panel = figure.add_subplot(grid[row, 1])
        points = _drawn(reference, image.size)
        pixels = load_image(model.root / reference.name).pixels
        draw_matches(
            panel,
            pixels,
            image.pixels,
            reference.matches.points1[points],
            reference.matches.points2[points],
            np.ones(len(points)),
        )
        count = int(reference.inliers.sum())
        panel.set_title(f"{reference.name}: {count} of {len(reference.matches)} matches agree")
    return figure


def _drawn(reference: Reference, size: tuple[int, int]) -> np.ndarray:
    """Indices of an even subsample of the inliers."""
    matches, chosen = reference.matches, np.flatnonzero(reference.inliers)
    kept = spread(matches.points2[chosen], matches.confidence[chosen], size, _DRAWN)
    return chosen[kept]
