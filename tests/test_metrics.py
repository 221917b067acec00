"""Errors of poses against SciPy's rotations, residuals against OpenCV's undistortion."""

import math

import cv2
import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from scipy.spatial.transform import Rotation

from dgc_pose.cameras.calibration import parse_camera
from dgc_pose.geometry.epipolar import essential_from_pose
from dgc_pose.metrics import epipolar_residuals_px, rotation_error_deg, translation_error_deg

seeds = st.integers(0, 2**32 - 1)


@given(seeds, st.floats(0, 180))
def test_rotation_error_is_the_angle_that_was_put_in(seed: int, angle: float) -> None:
    rng = np.random.default_rng(seed)
    R_gt = Rotation.random(rng=rng).as_matrix()
    axis = rng.normal(size=3)
    change = Rotation.from_rotvec(np.radians(angle) * axis / np.linalg.norm(axis)).as_matrix()
    for R in (R_gt @ change, change @ R_gt):
        assert rotation_error_deg(R, R_gt) == pytest.approx(angle, abs=1e-9)


def test_rotation_error_keeps_its_digits_near_0_and_180() -> None:
    for angle in (1e-7, 180 - 1e-7):
        R = Rotation.from_euler("z", angle, degrees=True).as_matrix()
        assert rotation_error_deg(R, np.eye(3)) == pytest.approx(angle, abs=1e-11)
    assert rotation_error_deg(np.diag([1.0, -1.0, -1.0]), np.eye(3)) == 180


@given(seeds, st.floats(0, 180), st.floats(1e-200, 1e200))
def test_translation_error_is_the_angle_whatever_the_lengths(seed, angle, length) -> None:
    rng = np.random.default_rng(seed)
    a, b, _ = Rotation.random(rng=rng).as_matrix().T
    t = math.cos(math.radians(angle)) * a + math.sin(math.radians(angle)) * b
    assert translation_error_deg(length * t, 3 * a) == pytest.approx(angle, abs=1e-9)
    assert translation_error_deg(-a, a) == 180


def test_residuals_of_a_distorted_camera_are_those_of_its_undistorted_points() -> None:
    camera = parse_camera("OPENCV,640,480,500,510,320,240,-0.2,0.05,0.001,-0.002")
    E = essential_from_pose(np.eye(3), np.array([1.0, 0.0, 0.0]))  # lines along the rows
    points = np.random.default_rng(0).uniform(50, 400, (2, 20, 2))
    lens = np.array([-0.2, 0.05, 0.001, -0.002])
    y1, y2 = (
        cv2.undistortPoints(part, camera.K, lens, P=camera.K).reshape(-1, 2)[:, 1]
        for part in points
    )
    residuals = epipolar_residuals_px(*points, camera, camera, E)
    np.testing.assert_allclose(residuals, np.abs(y1 - y2), rtol=1e-3, atol=1e-2)
