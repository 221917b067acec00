"""The points in space, colours and residuals of a pair."""

from dataclasses import replace

import numpy as np
import pycolmap
import pytest
from results import ambiguous_pose
from scenes import SIZE1, SIZE2, TwoViewScene, two_view_scene

from dgc_pose.cameras.camera import Camera
from dgc_pose.cameras.colmap_camera import Distortion
from dgc_pose.estimation import EstimationOptions, estimate_pose
from dgc_pose.images.image import Image
from dgc_pose.matches import Matches
from dgc_pose.pose import PairResult

LENS = Distortion("OPENCV", (-0.12, 0.03, 0.001, -0.001))


def result_of(scene: TwoViewScene, lens: Distortion | None = None) -> PairResult:
    """The result of a scene, its image 1 of noise."""
    cameras = tuple(replace(camera, distortion=lens) for camera in scene.cameras)
    points = [
        camera.project(ideal.normalise(points))
        for camera, ideal, points in zip(
            cameras, scene.cameras, (scene.points1, scene.points2), strict=True
        )
    ]
    matches = replace(scene.matches, points1=points[0], points2=points[1])
    options = EstimationOptions(runs=1, iterations=300)
    pose = estimate_pose(matches, *cameras, options)
    rng = np.random.default_rng(0)
    images = [Image(rng.integers(0, 256, (h, w, 3), np.uint8)) for w, h in (SIZE1, SIZE2)]
    return PairResult(*images, *cameras, matches, None, pose)


@pytest.mark.parametrize("lens", [None, LENS])
def test_the_points_are_those_that_colmap_triangulates(lens: Distortion | None) -> None:
    scene = two_view_scene(count=300, sigma_px=0.2)
    result = result_of(scene, lens)
    points, pose = result.points3d, result.pose
    assert points.shape == (300, 3) and points.dtype == np.float64
    known = np.isfinite(points).all(1)
    assert np.array_equal(known, pose.inliers) and 150 < known.sum() < 300
    assert np.isnan(points[~known]).all()
    # COLMAP's own triangulation, of points without distortion.
    matrices = np.eye(3, 4), np.column_stack([pose.R, pose.t])
    cameras = scene.cameras
    for index in np.flatnonzero(known)[::10]:
        rays = [
            camera.normalise(points[index : index + 1])[0]
            for camera, points in zip(cameras, (scene.points1, scene.points2), strict=True)
        ]
        expected = pycolmap.triangulate_point(*matrices, *rays)
        # They differ in how they share the noise between the images: a few pixels' worth.
        np.testing.assert_allclose(points[index], expected, rtol=0.02, atol=0.02)


def test_the_points_are_in_metres_where_t_has_a_length_and_none_behind_a_camera() -> None:
    result = result_of(two_view_scene(count=100, sigma_px=0.0, outliers=0.0))
    metric = replace(result, pose=replace(result.pose, length=2.5))
    np.testing.assert_allclose(metric.points3d, 2.5 * result.points3d)
    behind = replace(result, pose=replace(result.pose, t=-result.pose.t))  # a camera, all points
    assert np.isnan(behind.points3d).all()


def test_without_a_translation_there_are_neither_points_nor_residuals() -> None:
    result = result_of(two_view_scene("rotation_only"))
    assert result.pose.R is not None and result.pose.t is None
    assert result.points3d.shape == (1000, 3) and np.isnan(result.points3d).all()
    assert result.residuals_px.shape == (1000,) and np.isnan(result.residuals_px).all()


def test_the_colours_are_those_of_the_nearest_pixels_of_image_1() -> None:
    pixels = np.arange(4 * 5 * 3, dtype=np.uint8).reshape(4, 5, 3) + 1
    camera = Camera(np.diag([5.0, 5.0, 1.0]))
    points = np.array([(0, 0), (2.4, 1.6), (4.49, 3.49), (-0.5, -9), (7, 1), (np.nan, 2)])
    matches = Matches(points, points, np.ones(6), 1.0)
    pose = ambiguous_pose(6)
    image = Image(pixels)
    colours = PairResult(image, image, camera, camera, matches, None, pose).colours
    assert colours.dtype == np.uint8
    expected = [pixels[y, x] for x, y in ((0, 0), (2, 2), (4, 3), (0, 0), (4, 1))]
    np.testing.assert_array_equal(colours, [*expected, (0, 0, 0)])
