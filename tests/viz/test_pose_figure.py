from dataclasses import replace
from pathlib import Path

import cv2
import dense_scene
import numpy as np
import pytest
from matplotlib.patches import Circle
from results import ambiguous_pose
from worlds import CAMERA, IMAGE, PHOTO_CAMERA, world_scene

from dgc_pose.cameras.camera import Camera
from dgc_pose.cameras.colmap_camera import Distortion
from dgc_pose.estimation import EstimationOptions
from dgc_pose.images.image import load_image
from dgc_pose.localization.location import DatabaseImage, Location
from dgc_pose.pose import solve_pair
from dgc_pose.viz import plot_pose, save_figure
from dgc_pose.viz.pose_figure import plot_location


def result_of(correspondence_map):
    images = map(load_image, dense_scene.pictures(), ("image1", "image2"))
    camera = Camera(dense_scene.K, dense_scene.SIZE)
    matcher = dense_scene.MapMatcher(correspondence_map)
    options = EstimationOptions(runs=1, iterations=200)
    return solve_pair(*images, (camera, camera), matcher, options)


@pytest.fixture(scope="module")
def true():
    return result_of(dense_scene.true_map())


def title(axes):
    return axes.get_title(loc="left")


def test_all_panels_are_there(true):
    figure, pose = plot_pose(true), true.pose
    assert pose.success and len(plot_pose(replace(true, correspondence_map=None)).axes) == 3
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


def test_panels_have_the_names_of_the_files(true):
    """As they are: no formula, with the folder if both are alike, shortened if they are long."""
    for paths, names in (
        (("a/1.jpg", "b/1.jpg"), ("a/1.jpg", "b/1.jpg")),
        (("$a$.jpg", "long" * 20), ("$a$.jpg", "longlonglonglo ... glonglong")),
    ):
        images = (replace(true.image1, name=paths[0]), replace(true.image2, name=paths[1]))
        figure = plot_pose(replace(true, image1=images[0], image2=images[1]))
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
def test_each_match_lies_on_its_epipolar_line_or_curve(true, lens):
    camera = replace(true.camera1, distortion=lens)
    points = [
        camera.project(true.camera1.normalise(points))
        for points in (true.matches.points1, true.matches.points2)
    ]
    moved = replace(true.matches, points1=points[0], points2=points[1])
    bent = replace(true.pose, camera1=camera, camera2=camera)
    figure = plot_pose(replace(true, pose=bent, matches=moved))
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


def test_no_pose_and_no_matches_can_be_drawn(true, tmp_path):
    """Of an ambiguous pair neither pose is drawn."""
    pose = ambiguous_pose(len(true.matches))
    figure = plot_pose(replace(true, pose=pose))
    assert " ".join(figure.texts[0].get_text().split()) == f"no pose: {pose.reason}"
    matches, _, lines, *_ = figure.axes
    assert not lines.lines and title(lines).endswith("no epipolar lines without a pose")
    assert "confidence" in title(matches)  # not the residual
    nowhere, none = np.full((4, 4, 2), -9.0, np.float32), np.zeros((4, 4, 2), np.float32)
    result = result_of(dense_scene.make_map(nowhere, none))
    assert result.pose.num_matches == 0
    figure = plot_pose(result)
    (warped,) = figure.axes[4].images  # white outside image 1
    assert (warped.get_array() == 255).all()
    save_figure(figure, tmp_path / "p.png")
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


def test_a_location_is_drawn_with_its_error(tmp_path: Path) -> None:
    """The circle lies at the centre, in the mean camera's axes, and has nine tenths of it."""
    scene = world_scene()
    for name in (*scene.names, "new.png"):
        picture = np.random.default_rng(0).integers(0, 256, (*IMAGE[::-1], 3), np.uint8)
        cv2.imwrite(str(tmp_path / name), picture)
    model = replace(scene.model(), root=tmp_path, points=scene.points)
    references = tuple(
        DatabaseImage(name, scene.matches(i), np.arange(300) % 2 == 0, 0.9, agrees=i != 1)
        for i, name in enumerate(scene.names)
    )
    covariance = np.diag([1e-4] * 3 + [0.04] * 3)
    location = Location(
        *("located", "", references, scene.R, scene.centre),
        covariance=covariance,
        camera=PHOTO_CAMERA,
    )
    figure = plot_location(model, str(tmp_path / "new.png"), location)
    above, first, second = figure.axes
    (circle,) = above.patches
    assert isinstance(circle, Circle) and circle.radius == location.position_error_90
    (place,) = (line for line in above.lines if "query" in line.get_label())
    np.testing.assert_allclose(np.ravel(place.get_data()), circle.center)
    filled = next(line for line in above.lines if line.get_label() == "database images")
    assert len(filled.get_xdata()) == 4
    assert "150 of 300 matches agree" in first.get_title() and second.get_title()
    nowhere = Location("nowhere", "none of 5 database images", references[:1], camera=CAMERA)
    figure = plot_location(model, str(tmp_path / "new.png"), nowhere)
    assert not figure.axes[0].patches
    assert figure.get_suptitle() == "new.png: none of 5 database images"
