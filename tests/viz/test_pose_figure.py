from dataclasses import replace

import cv2
import dense_scene
import numpy as np
import pytest
from results import ambiguous_pose

from dgc_pose.cameras.camera import Camera
from dgc_pose.cameras.colmap_camera import Distortion
from dgc_pose.estimation import EstimationOptions
from dgc_pose.images.image import load_image
from dgc_pose.pose import solve_pair
from dgc_pose.viz.figure import save_figure
from dgc_pose.viz.pose_figure import plot_pose


def result_of(correspondence_map):
    images = map(load_image, dense_scene.pictures(), ("image1", "image2"))
    camera = Camera(dense_scene.K, dense_scene.SIZE)
    matcher = dense_scene.MapMatcher(correspondence_map)
    options = EstimationOptions(runs=1, iterations=200)
    return solve_pair(*images, (camera, camera), matcher, options)


def title(axes):
    return axes.get_title(loc="left")


def test_all_panels_are_there():
    result = result_of(dense_scene.true_map())
    figure, pose = plot_pose(result), result.pose
    assert pose.success and len(plot_pose(replace(result, correspondence_map=None)).axes) == 3
    matches, points, lines, matchability, warp = figure.axes
    segments = matches.collections[0].get_segments()
    assert 75 < len(segments) <= 150
    counts = f"{len(segments)} of {pose.num_inliers} inlier matches"
    assert counts in title(matches)
    assert 6 < len(lines.lines) == len(points.collections[0].get_offsets()) <= 12
    assert "matchability" in title(matchability) and "warped" in title(warp)
    headline = figure.texts[0].get_text()
    assert "probability not known for such matches" in headline
    assert headline.startswith("rotation ")


@pytest.mark.parametrize(
    ("paths", "names"),
    [
        (("a/1.jpg", "b/1.jpg"), ("a/1.jpg", "b/1.jpg")),
        (("$a$.jpg", "long" * 20), ("$a$.jpg", "longlonglonglo ... glonglong")),
    ],
)
def test_panels_have_the_names_of_the_files(paths, names):
    """As they are: no formula, and shortened if they are long."""
    result = result_of(dense_scene.true_map())
    images = (replace(result.image1, name=paths[0]), replace(result.image2, name=paths[1]))
    figure = plot_pose(replace(result, image1=images[0], image2=images[1]))
    _, points, lines, *_ = figure.axes
    assert title(points) == f"{names[0]}: points"
    assert " ".join(title(lines).split()) == f"{names[1]}: the same, and their epipolar lines"
    assert not points._left_title.get_parse_math()


@pytest.mark.parametrize(
    "lens",
    [
        None,
        Distortion("OPENCV", (-0.28, 0.07, 0.001, -0.001)),
        Distortion("OPENCV_FISHEYE", (0.1,) * 4),
    ],
)
def test_each_match_lies_on_its_epipolar_line_or_curve(lens):
    result = result_of(dense_scene.true_map())
    camera = replace(result.camera1, distortion=lens)
    points = [
        camera.project(result.camera1.normalise(points))
        for points in (result.matches.points1, result.matches.points2)
    ]
    moved = replace(result.matches, points1=points[0], points2=points[1])
    bent = replace(result.pose, camera1=camera, camera2=camera)
    figure = plot_pose(replace(result, pose=bent, matches=moved))
    axes = figure.axes[2]
    drawn = axes.collections[0].get_offsets()
    assert 6 < len(drawn) == len(axes.lines) <= 12
    bends = []
    for point, line in zip(drawn, axes.lines, strict=True):
        curve = line.get_xydata()
        curve = curve[np.isfinite(curve).all(axis=1)]
        assert np.linalg.norm(curve - point, axis=1).min() < 2  # they are up to 2 px apart
        first, last = curve[0], curve[-1]
        along = (last - first) / np.linalg.norm(last - first)
        bends.append(np.abs((curve - first) @ (-along[1], along[0])).max())
    assert max(bends) < 1e-6 if lens is None else max(bends) > 10


def test_no_pose_and_no_matches_can_be_drawn(tmp_path):
    """Of an ambiguous pair neither pose is drawn."""
    result = result_of(dense_scene.true_map())
    pose = ambiguous_pose(len(result.matches))
    figure = plot_pose(replace(result, pose=pose))
    assert " ".join(figure.texts[0].get_text().split()) == f"no pose: {pose.reason}"
    matches, _, lines, *_ = figure.axes
    assert not lines.lines and title(lines).endswith("no epipolar lines without a pose")
    assert "confidence" in title(matches)  # not the residual
    nowhere, none = np.full((4, 4, 2), -9.0, np.float32), np.zeros((4, 4, 2), np.float32)
    result = result_of(dense_scene.make_map(nowhere, none))
    assert result.pose.num_matches == 0
    save_figure(plot_pose(result), tmp_path / "p.png")
    assert cv2.imread(str(tmp_path / "p.png")) is not None


def test_the_colour_of_a_match_is_its_distance_from_the_epipolar_lines():
    result = result_of(dense_scene.true_map(error_px=0.5))
    drawn = plot_pose(result).axes[0].collections[0]
    first = np.array(drawn.get_segments())[:, 0]  # in image 1
    nearest = [np.linalg.norm(result.matches.points1 - point, axis=1).argmin() for point in first]
    green = drawn.get_colors()[:, 1]  # cyan to magenta: the less green the farther
    order = np.argsort(result.residuals_px[nearest])
    assert (np.diff(green[order]) <= 1e-6).all()
    assert green[order[0]] > 0.8 and green[order[-1]] == 0
