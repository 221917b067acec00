"""One figure that shows what a pose was estimated from."""

from itertools import chain

import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure

from dgc_pose.estimation import RelativePose
from dgc_pose.geometry.epipolar import fundamental_from_essential, homogeneous
from dgc_pose.geometry.rotation import rotation_angle_deg
from dgc_pose.matches import Matches
from dgc_pose.metrics.epipolar import epipolar_residuals_px
from dgc_pose.pose import Trace
from dgc_pose.viz.layout import WIDTH, Panel, panel_rows, row_height
from dgc_pose.viz.panels import (
    GAP,
    draw_colour_bar,
    draw_image,
    draw_lines,
    draw_matchability,
    draw_matches,
    draw_points,
    draw_warp,
    residual_colours,
)

DRAWN_MATCHES = 150
DRAWN_LINES = 12
_MAX_HEIGHT = 16.0  # inches of panels; beyond, all of them stand in one row
_NARROW = 7.0  # inches; the width of a figure of upright images


def plot_pose(trace: Trace) -> Figure:
    """Draw the inlier matches coloured by their residual, some epipolar lines and, if the matcher
    gives a map, the matchability and image 1 warped onto image 2.

    The residual is the symmetric epipolar distance in pixels. Only an even subsample of the matches
    is drawn. Without an essential matrix matches are coloured by confidence, and there are no
    lines. Epipolar lines are those of the pinhole cameras K, without lens distortion.
    """
    pose = trace.pose
    chosen = np.flatnonzero(pose.inliers) if pose.inliers.any() else np.arange(len(trace.matches))
    drawn = _spread(trace.matches, chosen, DRAWN_MATCHES)
    rows = _rows(trace, f"{len(drawn)} of {len(chosen)}")
    for width in (WIDTH, _NARROW):
        if sum(row_height(row, width) for row in rows) <= _MAX_HEIGHT:
            break
    else:
        rows, width = [list(chain(*rows))], WIDTH
    figure, axes = panel_rows(rows, _headline(pose), width=width)
    matches, points, lines, *map_axes = chain(*axes)
    _draw_matches(matches, trace, drawn)
    _draw_epipolar(points, lines, trace, _spread(trace.matches, chosen, DRAWN_LINES))
    if trace.correspondence_map is not None:
        left, right = map_axes
        places, matchability = trace.correspondence_map.map, trace.correspondence_map.matchability
        colours = draw_matchability(left, trace.image2.pixels, matchability)
        draw_colour_bar(left, colours, "")
        draw_warp(right, trace.image1.pixels, places, matchability, trace.image2.size)
    return figure


def _headline(pose: RelativePose) -> str:
    if not (pose.success and pose.R is not None):
        return f"no pose: {pose.reason}"
    text = f"rotation {rotation_angle_deg(pose.R):.2f}°, translation known up to scale"
    if pose.rotation_error_90_deg is None or pose.translation_error_90_deg is None:
        return text
    return (
        f"{text}; nine times in ten R is within {pose.rotation_error_90_deg:.3f}° "
        f"and t within {pose.translation_error_90_deg:.3f}°"
    )


def _rows(trace: Trace, counts: str) -> list[list[Panel]]:
    aspect1, aspect2 = (width / height for width, height in (trace.image1.size, trace.image2.size))
    kind = "inlier matches" if trace.pose.inliers.any() else "matches, no inliers"
    no_lines = "image 2: no essential matrix, so no epipolar lines"
    lines = "their epipolar lines in image 2, and their matches"
    rows = [
        [Panel((1 + GAP) * aspect1 + aspect2, f"{counts} {kind}", bar=True)],
        [
            Panel(aspect1, "points of image 1"),
            Panel(aspect2, no_lines if trace.pose.E is None else lines),
        ],
    ]
    if trace.correspondence_map is not None:
        warp = "image 1 warped onto image 2, pale if not matchable"
        rows.append([Panel(aspect2, "matchability over image 2", bar=True), Panel(aspect2, warp)])
    return rows


def _draw_matches(axes: Axes, trace: Trace, drawn: np.ndarray) -> None:
    matches, E = trace.matches.subset(drawn), trace.pose.E
    points1, points2 = matches.points1, matches.points2
    values, colours, label = matches.confidence, None, "confidence"
    if E is not None:
        values = epipolar_residuals_px(points1, points2, trace.camera1, trace.camera2, E)
        colours, label = residual_colours(values), "residual (px)"
    pixels1, pixels2 = trace.image1.pixels, trace.image2.pixels
    colours = draw_matches(axes, pixels1, pixels2, points1, points2, values, colours=colours)
    draw_colour_bar(axes, colours, label)


def _draw_epipolar(left: Axes, right: Axes, trace: Trace, drawn: np.ndarray) -> None:
    matches = trace.matches.subset(drawn)
    draw_image(left, trace.image1.pixels)
    draw_image(right, trace.image2.pixels)
    if trace.pose.E is not None:
        F = fundamental_from_essential(trace.pose.E, trace.camera1.K, trace.camera2.K)
        draw_lines(right, homogeneous(matches.points1) @ F.T)
    draw_points(left, matches.points1)
    draw_points(right, matches.points2)


def _spread(matches: Matches, chosen: np.ndarray, count: int) -> np.ndarray:
    """Indices of an even subsample, over image 2, of the chosen matches with finite points."""
    points = np.hstack([matches.points1, matches.points2])
    chosen = chosen[np.isfinite(points[chosen]).all(axis=1)]
    return chosen[spread_evenly(matches.points2[chosen], count)]


def spread_evenly(points: np.ndarray, count: int) -> np.ndarray:
    """Farthest point sampling: each point is the farthest from all that were chosen before.

    points: (N, 2) pixels, finite. Returns at most `count` indices (M,) in increasing order, of
    points that all differ.
    """
    distances = np.full(len(points), np.inf)
    chosen: list[int] = []
    while len(chosen) < min(count, len(points)):
        farthest = int(np.argmax(distances))
        if distances[farthest] == 0:
            break
        chosen.append(farthest)
        distances = np.minimum(distances, np.sum((points - points[farthest]) ** 2, axis=1))
    return np.array(sorted(chosen), dtype=np.intp)
