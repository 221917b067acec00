import cv2
import numpy as np
import pytest

from dgc_pose.cameras.calibration import parse_camera
from dgc_pose.cameras.camera import Camera
from dgc_pose.geometry.epipolar import essential_from_pose
from dgc_pose.metrics.epipolar import epipolar_residuals_px, median_and_mean


def test_epipolar_figures_are_those_of_the_equation() -> None:
    """Against the distances of points and lines, one by one, and in the presence of infinities."""
    rng = np.random.default_rng(0)
    F = rng.standard_normal((3, 3))
    points1, points2 = rng.uniform(0, 100, (2, 25, 2))
    expected = []
    for (x1, y1), (x2, y2) in zip(points1, points2, strict=True):
        a, b, c = F @ [x1, y1, 1]
        d, e, f = F.T @ [x2, y2, 1]
        to_line2 = abs(a * x2 + b * y2 + c) / np.hypot(a, b)
        to_line1 = abs(d * x1 + e * y1 + f) / np.hypot(d, e)
        expected.append((to_line1 + to_line2) / 2)
    found = median_and_mean(points1.reshape(5, 5, 2), points2.reshape(5, 5, 2), F)
    assert found == pytest.approx((np.median(expected), np.mean(expected)))
    points1[:3] = np.inf
    median, mean = median_and_mean(points1, points2, F)
    assert median == pytest.approx(np.sort([np.inf] * 3 + expected[3:])[12]) and mean == np.inf
    assert median_and_mean(np.zeros((0, 2)), np.zeros((0, 2)), F) == (np.inf, np.inf)


def test_residuals_of_a_distorted_camera_are_those_of_its_undistorted_points() -> None:
    lens = "OPENCV,640,480,500,510,320,240,-0.2,0.05,0.001,-0.002"
    camera = parse_camera(lens)
    R, t = np.eye(3), np.array([1.0, 0.0, 0.0])
    E = essential_from_pose(R, t)  # a step to the right: lines along the rows
    rng = np.random.default_rng(0)
    points1, points2 = rng.uniform(50, 400, (2, 20, 2))
    found = epipolar_residuals_px(points1, points2, camera, camera, E)
    y1, y2 = (
        cv2.undistortPoints(
            points, camera.K, np.array([-0.2, 0.05, 0.001, -0.002]), P=camera.K
        ).reshape(-1, 2)[:, 1]
        for points in (points1, points2)
    )
    np.testing.assert_allclose(found, np.abs(y1 - y2), rtol=1e-3, atol=1e-2)
    pinhole = Camera(camera.K)
    found = epipolar_residuals_px(points1, points2, pinhole, pinhole, E)
    np.testing.assert_allclose(found, np.abs(points1[:, 1] - points2[:, 1]), rtol=1e-9)
