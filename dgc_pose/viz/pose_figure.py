"""One figure that shows what a pose was estimated from."""

import textwrap
from collections.abc import Sequence
from pathlib import Path

import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure

from dgc_pose.cameras.camera import Camera
from dgc_pose.errors import printable, shortened
from dgc_pose.estimation import RelativePose
from dgc_pose.estimation.status import probability_text
from dgc_pose.geometry.epipolar import homogeneous
from dgc_pose.geometry.rotation import rotation_angle_deg
from dgc_pose.geometry.sampling import spread
from dgc_pose.pair_result import PairResult
from dgc_pose.viz.figure import WIDTH, new_figure
from dgc_pose.viz.panels import (
    draw_curves,
    draw_image,
    draw_matchability,
    draw_matches,
    draw_points,
    draw_warp,
    residual_colours,
    second_place,
)

DRAWN_MATCHES = 150
DRAWN_LINES = 12
_CURVE_POINTS = 500  # of an epipolar line through a lens
# Ends of the rows of panels, the largest panels first.
_ARRANGEMENTS = ((1, 2, 3, 4, 5), (1, 3, 5), (1, 5), (5,))
_MAX_HEIGHT = 1.4  # of all rows, as a share of the width
# Inches: between the panels of a row; around the figure; of a line of text; the mean character of a
# title; the height of a row at most.
_GAP, _MARGIN, _LINE, _CHARACTER, _MAX_PANEL = 0.1, 0.08, 0.19, 0.078, 20.0
_NAME = 28  # characters of a file's name


def plot_pose(result: PairResult) -> Figure:
    """Draw the inlier matches coloured by their residual, some epipolar lines and, if the matcher
    gives a map, the matchability and image 1 warped onto image 2.

    The residual is the symmetric epipolar distance in pixels. Only an even subsample of the matches
    is drawn. Without a pose matches are coloured by confidence, and there are no lines. Through a
    lens with distortion an epipolar line is a curve.
    """
    pose, dense = result.pose, result.correspondence_map
    image1, image2 = result.image1, result.image2
    chosen = np.flatnonzero(pose.inliers) if pose.inliers.any() else np.arange(len(result.matches))
    shown = _spread(result, chosen, DRAWN_MATCHES)
    matches, values, colours = result.matches.subset(shown), result.matches.confidence[shown], None
    legend = "magenta to cyan: confidence 0 to 1"
    if pose.E is not None:
        values = result.residuals_px[shown]
        colours = residual_colours(values)
        legend = f"cyan to magenta: residuals of 0 to {colours.get_clim()[1]:.2g} px"
    panels = _panels(result, f"{len(shown)} of {len(chosen)}", legend)
    figure, (lines_axes, left, right, *map_axes) = _panels_in_rows(panels, _headline(pose))
    points = matches.points1, matches.points2
    draw_matches(lines_axes, image1.pixels, image2.pixels, *points, values, colours=colours)
    matches = result.matches.subset(_spread(result, chosen, DRAWN_LINES))
    draw_image(left, image1.pixels)
    draw_image(right, image2.pixels)
    if pose.E is not None:
        lines = homogeneous(result.camera1.normalise(matches.points1)) @ pose.E.T
        draw_curves(right, [_through_lens(line, result.camera2) for line in lines])
    draw_points(left, matches.points1)
    draw_points(right, matches.points2)
    if dense is not None:
        draw_matchability(map_axes[0], image2.pixels, dense.matchability)
        draw_warp(map_axes[1], image1.pixels, dense.map, dense.matchability, image2.size)
    return figure


def _headline(pose: RelativePose) -> str:
    if not (pose.success and pose.R is not None):
        return f"no pose: {pose.reason}"
    text = f"rotation {rotation_angle_deg(pose.R):.2f}°, translation {pose.length_text}"
    text += f"; {probability_text(pose.probability, 'that R and t are within 10°')}"
    if pose.rotation_error_90_deg is None or pose.translation_error_90_deg is None:
        return text
    return (
        f"{text}\nexpected error: R within {pose.rotation_error_90_deg:.3f}°, t within "
        f"{pose.translation_error_90_deg:.3f}°, nine times in ten if the pose is right"
    )


def _panels(result: PairResult, counts: str, legend: str) -> list[tuple[float, str]]:
    """The aspects and titles of the panels."""
    aspect1, aspect2 = (
        width / height for width, height in (result.image1.size, result.image2.size)
    )
    *_, width, height, _ = second_place(result.image1.pixels, result.image2.pixels)
    paths = Path(result.image1.name), Path(result.image2.name)
    same = paths[0].name == paths[1].name
    name1, name2 = (shortened(printable(str(p) if same else p.name), _NAME) for p in paths)
    kind = "inlier matches" if result.pose.inliers.any() else "matches, no inliers"
    lines = "no epipolar lines without a pose" if result.pose.E is None else "their epipolar lines"
    panels = [
        (width / height, f"{name1} and {name2}: {counts} {kind}; {legend}"),
        (aspect1, f"{name1}: points"),
        (aspect2, f"{name2}: the same, and {lines}"),
        (aspect2, f"{name2}: matchability, dark 0 to yellow 1"),
        (aspect2, f"{name1} warped onto {name2}, pale if not matchable"),
    ]
    return panels[: 3 if result.correspondence_map is None else 5]


def _panels_in_rows(
    panels: Sequence[tuple[float, str]], headline: str
) -> tuple[Figure, list[Axes]]:
    """A figure `WIDTH` wide and the axes of its panels, of which each is given by its aspect and
    its title. The panels of a row have one height and fill the width, so that no band stays blank.
    Titles are broken where their panel is narrow; the headline stands above all."""
    for ends in _ARRANGEMENTS:
        rows = [panels[i:j] for i, j in zip((0, *ends), ends, strict=False) if panels[i:j]]
        free = [WIDTH - 2 * _MARGIN - _GAP * (len(row) - 1) for row in rows]
        wide = [sum(aspect for aspect, _ in row) for row in rows]
        heights = [min(f / w, _MAX_PANEL) for f, w in zip(free, wide, strict=True)]
        if sum(heights) <= _MAX_HEIGHT * WIDTH:
            break
    head = _wrapped(headline, WIDTH - 2 * _MARGIN)
    titles = [
        [_wrapped(title, aspect * height) for aspect, title in row]
        for row, height in zip(rows, heights, strict=True)
    ]
    strips = [0.14 + _LINE * max(map(len, of_row)) for of_row in titles]
    top = _MARGIN + _LINE * len(head)
    total = top + sum(heights) + sum(strips) + _MARGIN
    figure = new_figure(WIDTH, total)
    figure.set_layout_engine("none")
    corner = _MARGIN / WIDTH, 1 - _MARGIN / total
    # Without mathematics: the name of a file may be what would be a formula.
    figure.text(*corner, "\n".join(head), va="top", fontsize=10, parse_math=False)
    drawn = []
    for row, of_row, height, strip in zip(rows, titles, heights, strips, strict=True):
        top += strip + height
        sizes = [aspect * height for aspect, _ in row]
        left = (WIDTH - sum(sizes) - _GAP * (len(row) - 1)) / 2
        for size, title in zip(sizes, of_row, strict=True):
            box = (left / WIDTH, 1 - top / total, size / WIDTH, height / total)
            drawn.append(figure.add_axes(box))
            drawn[-1].set_title("\n".join(title), fontsize=10, loc="left", parse_math=False, pad=4)
            left += size + _GAP
    return figure, drawn


def _wrapped(text: str, width: float) -> list[str]:
    most = max(8, int(width / _CHARACTER))
    return [line for part in text.splitlines() for line in textwrap.wrap(part, most)]


def _through_lens(line: np.ndarray, camera: Camera) -> np.ndarray:
    """The pixels (M, 2) of a line (3,) of normalised points; NaN where the lens shows none."""
    angles = np.radians(np.linspace(-88, 88, _CURVE_POINTS))[:, None]
    with np.errstate(divide="ignore", invalid="ignore"):  # of an epipole, and of a line at infinity
        normal = line / np.linalg.norm(line)
        towards = np.array([0, 0, 1]) - normal[2] * normal  # the ray nearest to the optical axis
        towards /= np.linalg.norm(towards)
        rays = np.cos(angles) * towards + np.sin(angles) * np.cross(normal, towards)
        points = np.where(rays[:, 2:] > 0, rays[:, :2] / rays[:, 2:], np.nan)
    pixels = camera.project(points)
    # A model folds rays from outside of its range back into the image.
    near = np.abs(camera.normalise(pixels) - points) < 1e-3 * (1 + np.abs(points))
    return np.where(near.all(axis=1, keepdims=True), pixels, np.nan)


def _spread(result: PairResult, chosen: np.ndarray, count: int) -> np.ndarray:
    """Indices of the most confident of the chosen matches, spread over image 2, with finite
    points."""
    matches = result.matches
    points = np.hstack([matches.points1, matches.points2])
    chosen = chosen[np.isfinite(points[chosen]).all(axis=1)]
    points2, confidence = matches.points2[chosen], matches.confidence[chosen]
    return chosen[spread(points2, confidence, result.image2.size, count)]
