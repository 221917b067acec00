"""One figure that shows what a pose was estimated from."""

from __future__ import annotations

import numpy as np
from matplotlib.figure import Figure
from matplotlib.gridspec import GridSpec

from dgc_pose.estimation import RelativePose
from dgc_pose.geometry.epipolar import fundamental_from_essential, homogeneous
from dgc_pose.geometry.rotation import rotation_angle_deg
from dgc_pose.image import Image
from dgc_pose.matches import Matches
from dgc_pose.matching import CorrespondenceMap
from dgc_pose.pose import Trace
from dgc_pose.viz.figure import new_figure
from dgc_pose.viz.panels import (
    show_colour_bar,
    show_image,
    show_lines,
    show_matchability,
    show_matches,
    show_points,
    show_warp,
)
from dgc_pose.viz.subsample import spread_evenly

DRAWN_MATCHES = 150
DRAWN_LINES = 12
WIDTH = 12.0  # inches


def plot_pose(trace: Trace) -> Figure:
    """Draw the inlier matches coloured by confidence, some epipolar lines and, if the matcher gives
    a map, the matchability and image 1 warped onto image 2.

    Only an even subsample of the matches is drawn. Without an essential matrix there are points and
    no lines. Epipolar lines are those of the pinhole cameras K, without lens distortion.
    """
    pose, matches = trace.pose, trace.matches
    rows = 2 if trace.correspondence_map is None else 3
    heights = _row_heights(trace.image1, trace.image2, rows)
    figure = new_figure(WIDTH, sum(heights) + 0.4 * rows + 0.3)
    figure.suptitle(_headline(pose), fontsize=11)
    grid = figure.add_gridspec(rows, 2, height_ratios=heights)
    chosen = np.flatnonzero(pose.inliers) if pose.inliers.any() else np.arange(len(matches))
    _draw_matches(figure, grid, trace, chosen)
    _draw_epipolar(figure, grid, trace, chosen)
    if trace.correspondence_map is not None:
        _draw_map(figure, grid, trace, trace.correspondence_map)
    return figure


def _headline(pose: RelativePose) -> str:
    if pose.success and pose.R is not None:
        return f"rotation {rotation_angle_deg(pose.R):.2f}°, translation known up to scale"
    return f"no pose: {pose.reason}"


def _row_heights(image1: Image, image2: Image, rows: int) -> list[float]:
    """Heights in inches: both images side by side, then rows of two panels of half the width."""
    aspects = [image.size[0] / image.size[1] for image in (image1, image2)]
    side_by_side = WIDTH / sum(aspects)
    halves = WIDTH / 2 / min(aspects)
    # A figure of very tall images would fit no screen.
    return [min(side_by_side, 8.0)] + [min(halves, 5.5)] * (rows - 1)


def _draw_matches(figure: Figure, grid: GridSpec, trace: Trace, chosen: np.ndarray) -> None:
    matches = trace.matches
    drawn = _spread(matches, chosen, DRAWN_MATCHES)
    kind = "inlier matches" if trace.pose.inliers.any() else "matches, no inliers"
    axes = figure.add_subplot(grid[0, :])
    colours = show_matches(
        axes,
        trace.image1.pixels,
        trace.image2.pixels,
        matches.points1[drawn],
        matches.points2[drawn],
        matches.confidence[drawn],
        f"{len(drawn)} of {len(chosen)} {kind}",
    )
    show_colour_bar(axes, colours, "confidence")


def _draw_epipolar(figure: Figure, grid: GridSpec, trace: Trace, chosen: np.ndarray) -> None:
    drawn = _spread(trace.matches, chosen, DRAWN_LINES)
    points1, points2 = trace.matches.points1[drawn], trace.matches.points2[drawn]
    left, right = (figure.add_subplot(grid[1, column]) for column in range(2))
    show_image(left, trace.image1.pixels, "points of image 1")
    if trace.pose.E is None:
        show_image(right, trace.image2.pixels, "no essential matrix, so no epipolar lines")
    else:
        show_image(right, trace.image2.pixels, "their epipolar lines in image 2, and their matches")
        F = fundamental_from_essential(trace.pose.E, trace.camera1.K, trace.camera2.K)
        show_lines(right, homogeneous(points1) @ F.T)
    show_points(left, points1)
    show_points(right, points2)


def _draw_map(
    figure: Figure, grid: GridSpec, trace: Trace, correspondence_map: CorrespondenceMap
) -> None:
    left, right = (figure.add_subplot(grid[2, column]) for column in range(2))
    image1, image2 = trace.image1, trace.image2
    matchability = correspondence_map.matchability
    title = "image 1 warped onto image 2, pale if not matchable"
    colours = show_matchability(left, image2.pixels, matchability, "matchability over image 2")
    show_colour_bar(left, colours, "")
    show_warp(right, image1.pixels, correspondence_map.map, matchability, image2.size, title)


def _spread(matches: Matches, chosen: np.ndarray, count: int) -> np.ndarray:
    """Indices of an even subsample, over image 2, of the chosen matches with finite points."""
    points = np.hstack([matches.points1, matches.points2])
    chosen = chosen[np.isfinite(points[chosen]).all(axis=1)]
    return chosen[spread_evenly(matches.points2[chosen], count)]
