"""Whole figures: the matches behind a pose, and the location of a query in a model."""

import textwrap
from pathlib import Path

import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from matplotlib.patches import Circle

from dgc_pose.cameras.camera import Camera
from dgc_pose.errors import printable, shortened
from dgc_pose.estimation import RelativePose
from dgc_pose.estimation.status import probability_text
from dgc_pose.geometry.epipolar import homogeneous
from dgc_pose.geometry.rotation import rotation_angle_deg
from dgc_pose.geometry.sampling import spread
from dgc_pose.images.image import load_image
from dgc_pose.localization.location import Location
from dgc_pose.model import Model
from dgc_pose.pose import PairResult
from dgc_pose.viz.figure import (
    WIDTH,
    draw_curves,
    draw_image,
    draw_matchability,
    draw_matches,
    draw_points,
    draw_warp,
    new_figure,
    residual_colours,
    second_place,
)
from dgc_pose.viz.model_page import mean_axes

DRAWN_MATCHES = 150
DRAWN_LINES = 12
_CURVE_POINTS = 500  # of an epipolar line through a lens
_UPRIGHT = 2.0  # up to this sum of the images' width over height, a row has four panels, else two
_TALLEST = 10.0  # largest height of a row, inches
_LINE = 0.19  # height of a line of text, inches
_CHARACTER = 0.078  # mean width of a character, inches
_NAME = 28  # characters of a file's name
_LOCATED_MATCHES = 100  # drawn for each database image
_FAR = 0.02  # share of points cut off at each end of an axis, as they may be far away


def plot_pose(result: PairResult) -> Figure:
    """Draw the inlier matches coloured by their residual, some epipolar lines and, if the matcher
    gives a map, the matchability and image 1 warped onto image 2.

    The residual is the symmetric epipolar distance in pixels. Only an even subsample of the matches
    is drawn. Without a pose, the confidence colours the matches, and there are no lines. Through a
    lens with distortion, an epipolar line is a curve.
    """
    pose = result.pose
    dense = result.correspondence_map
    image1 = result.image1
    image2 = result.image2
    chosen = np.flatnonzero(pose.inliers) if pose.inliers.any() else np.arange(len(result.matches))
    shown = _spread(result, chosen, DRAWN_MATCHES)
    matches = result.matches.subset(shown)
    values = result.matches.confidence[shown]
    colours = None
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
        f"{pose.translation_error_90_deg:.3f}° in 90 % of cases, if the pose is right"
    )


def _panels(result: PairResult, counts: str, legend: str) -> list[tuple[float, str]]:
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


def _panels_in_rows(panels: list[tuple[float, str]], headline: str) -> tuple[Figure, list[Axes]]:
    """A figure with a headline, `WIDTH` wide, and the axes of its panels. panels: aspect and title
    of each. The first panel fills a row; the others are in rows of two or four of equal height."""
    across = 2 if panels[1][0] + panels[2][0] > _UPRIGHT else 4
    rows = [panels[:1], *(panels[i : i + across] for i in range(1, len(panels), across))]
    heights = []
    for row in rows:
        wide = sum(aspect for aspect, _ in row)
        titles = [_wrapped(title, WIDTH * aspect / wide) for aspect, title in row]
        lines = max(title.count("\n") + 1 for title in titles)
        heights.append(min(WIDTH / wide, _TALLEST) + _LINE * (lines + 0.7))
    text = _wrapped(headline, WIDTH)
    figure = new_figure(WIDTH, sum(heights) + _LINE * (text.count("\n") + 1.5))
    # Not parsed as a formula: the text may contain file names.
    figure.suptitle(text, x=0.01, ha="left", fontsize=10, parse_math=False)
    drawn = []
    parts = figure.subfigures(len(rows), 1, squeeze=False, height_ratios=heights)
    for row, part in zip(rows, parts[:, 0], strict=True):
        aspects = [aspect for aspect, _ in row]
        axes_of_row = part.subplots(1, len(row), width_ratios=aspects, squeeze=False)[0]
        for axes, (aspect, title) in zip(axes_of_row, row, strict=True):
            words = _wrapped(title, WIDTH * aspect / sum(aspects))
            axes.set_title(words, fontsize=10, loc="left", parse_math=False)
            drawn.append(axes)
    return figure, drawn


def _wrapped(text: str, width: float) -> str:
    """Wrap a text to a width in inches."""
    most = max(8, int(width / _CHARACTER))
    return "\n".join(textwrap.fill(line, most) for line in text.splitlines())


def _through_lens(line: np.ndarray, camera: Camera) -> np.ndarray:
    """The pixels (M, 2) of a line (3,) of normalised points; NaN outside the lens's range."""
    angles = np.radians(np.linspace(-88, 88, _CURVE_POINTS))[:, None]
    with np.errstate(divide="ignore", invalid="ignore"):  # an epipole; a line at infinity
        normal = line / np.linalg.norm(line)
        towards = np.array([0, 0, 1]) - normal[2] * normal  # the ray nearest to the optical axis
        towards /= np.linalg.norm(towards)
        rays = np.cos(angles) * towards + np.sin(angles) * np.cross(normal, towards)
        points = np.where(rays[:, 2:] > 0, rays[:, :2] / rays[:, 2:], np.nan)
    pixels = camera.project(points)
    # A lens model folds rays from outside its range back into the image.
    near = np.abs(camera.normalise(pixels) - points) < 1e-3 * (1 + np.abs(points))
    return np.where(near.all(axis=1, keepdims=True), pixels, np.nan)


def _spread(result: PairResult, chosen: np.ndarray, count: int) -> np.ndarray:
    """Indices of the most confident of the chosen matches, spread over image 2, without NaN."""
    matches = result.matches
    points = np.hstack([matches.points1, matches.points2])
    chosen = chosen[np.isfinite(points[chosen]).all(axis=1)]
    points2 = matches.points2[chosen]
    confidence = matches.confidence[chosen]
    return chosen[spread(points2, confidence, result.image2.size, count)]


def plot_location(model: Model, query: str, location: Location) -> Figure:
    """Draw the model from above with the query and its error, and the matches with the two database
    images of most inliers."""
    figure = new_figure(WIDTH, WIDTH / 2)
    grid = figure.add_gridspec(2, 2, width_ratios=(1, 1.2))
    headline = location.reason
    if location.success:
        headline = (
            f"R within {location.rotation_error_90_deg or 0:.2f}°, centre within "
            f"{location.position_error_90 or 0:.2g} in 90 % of cases, if it is right"
        )
    figure.suptitle(f"{printable(Path(query).name)}: {headline}", parse_math=False)
    _draw_place(figure.add_subplot(grid[:, 0]), model, location)
    image = load_image(query)
    used = [matched for matched in location.database_images if matched.agrees]
    best = sorted(used or location.database_images, key=lambda m: -m.inliers.sum())[:2]
    for row, matched in enumerate(best):
        matches = matched.matches.subset(matched.inliers)
        drawn = matches.subset(
            spread(matches.points2, matches.confidence, image.size, _LOCATED_MATCHES)
        )
        pixels = load_image(model.root / matched.name).pixels
        panel = figure.add_subplot(grid[row, 1])
        draw_matches(panel, pixels, image.pixels, drawn.points1, drawn.points2, drawn.confidence)
        count = f"{len(matches)} of {len(matched.matches)} matches agree"
        panel.set_title(f"{matched.name}: {count}")
    return figure


def _draw_place(panel: Axes, model: Model, location: Location) -> None:
    """Draw the cameras, as arrows along their axes, and points, in x and z of the mean camera."""
    names = [*model.poses]
    poses = [*model.poses.values()]
    centres = [model.centre(name) for name in names]
    above = mean_axes(poses)[[0, 2]]  # to the right and ahead
    points = model.points @ above.T
    if len(points):
        low, high = np.quantile(points, (_FAR, 1 - _FAR), axis=0)
        points = points[((points >= low) & (points <= high)).all(1)]
    panel.scatter(points[:, 0], points[:, 1], s=2.5, color="0.7", linewidths=0)
    agree = [centres[names.index(m.name)] @ above.T for m in location.database_images if m.agrees]
    panel.plot(
        *np.reshape(agree, (-1, 2)).T, "o", color="black", markersize=4, label="database images"
    )
    colours = ["gray"] * len(names)
    if location.cam_from_world is not None and location.centre is not None:
        poses = [*poses, location.cam_from_world]
        centres = [*centres, location.centre]
        colours.append("tab:blue")
        middle = above @ location.centre
        radius = location.position_error_90 or 0
        panel.plot(*middle, "o", color="tab:blue", markersize=4, label="the query, and its error")
        panel.add_patch(Circle(middle, radius, color="tab:blue", alpha=0.3))
    tails = np.stack(centres) @ above.T
    ahead = np.stack(poses)[:, 2, :3] @ above.T
    panel.quiver(*tails.T, *ahead.T, color=colours, angles="xy", width=0.006, scale=15)
    panel.margins(0.1)
    panel.set_aspect("equal", adjustable="datalim")
    panel.set(title="from above", xlabel="x", ylabel="z")
    panel.legend(loc="best", fontsize=8)
