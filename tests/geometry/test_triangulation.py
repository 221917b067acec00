import math

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from scipy.optimize import least_squares
from scipy.spatial.transform import Rotation

from dgc_pose.geometry.epipolar import essential_from_pose
from dgc_pose.geometry.triangulation import depths, epipolar_angles, triangulation_angles_deg

R = Rotation.from_rotvec([0.1, -0.3, 0.05]).as_matrix()
T = np.array([1.0, 0.2, -0.1]) / np.linalg.norm([1.0, 0.2, -0.1])


def exact(count=30, seed=0, depth=6.0):
    """Points in the frame of camera 1 and both their projections."""
    X = np.random.default_rng(seed).uniform(-1, 1, (count, 3)) * 2 + (0, 0, depth)
    local = X @ R.T + T
    return X, X[:, :2] / X[:, 2:], local[:, :2] / local[:, 2:], local


@given(st.integers(0, 2**32 - 1))
@settings(max_examples=25, deadline=None)
def test_exact_matches_give_their_depths(seed):
    X, points1, points2, local = exact(seed=seed)
    depth1, depth2 = depths(points1, points2, R, T)
    np.testing.assert_allclose(depth1, X[:, 2], rtol=1e-6)
    np.testing.assert_allclose(depth2, local[:, 2], rtol=1e-6)


def test_noisy_matches_give_the_depths_of_the_nearest_ends_of_their_rays():
    _, points1, points2, _ = exact(count=5)
    points2 = points2 + 0.01 * np.random.default_rng(1).standard_normal(points2.shape)
    depth1, depth2 = depths(points1, points2, R, T)
    for p, q, d1, d2 in zip(points1, points2, depth1, depth2, strict=True):
        gap = least_squares(
            lambda d, p=p, q=q: d[0] * (R @ [*p, 1]) + T - d[1] * np.array([*q, 1]), [1, 1]
        )
        np.testing.assert_allclose([d1, d2], gap.x, rtol=1e-5)


def test_points_behind_a_camera_have_negative_depth():
    X = np.array([[0.5, 0.2, -4.0], [0.1, 0.3, 5.0]])
    local = X @ R.T + T
    depth1, depth2 = depths(X[:, :2] / X[:, 2:], local[:, :2] / local[:, 2:], R, T)
    assert (depth1 > 0).tolist() == [False, True]
    assert (depth2 > 0).tolist() == [False, True]
    flipped1, flipped2 = depths(X[:, :2] / X[:, 2:], local[:, :2] / local[:, 2:], R, -T)
    assert (flipped1 > 0).tolist() == [True, False]
    assert (flipped2 > 0).tolist() == [True, False]


def test_parallel_rays_meet_at_infinity_and_not_at_nan():
    points = np.array([[0.0, 0.0], [0.3, -0.2]])
    depth1, depth2 = depths(points, points, np.eye(3), np.array([1.0, 0, 0]))
    assert not np.isnan(depth1).any() and not np.isnan(depth2).any()
    assert (np.abs(depth1) > 1e12).all()


def test_the_triangulation_angle_is_seen_from_the_point():
    X, points1, points2, _ = exact()
    centre2 = -R.T @ T
    found = triangulation_angles_deg(points1, points2, R)
    for point, angle in zip(X, found, strict=True):
        a, b = -point, centre2 - point
        expected = math.acos(a @ b / np.linalg.norm(a) / np.linalg.norm(b))
        assert angle == pytest.approx(math.degrees(expected), abs=1e-6)


def test_the_epipolar_angle_is_the_rotation_that_brings_ray_2_into_the_plane():
    _, points1, points2, _ = exact(count=10)
    E = essential_from_pose(R, T)
    assert epipolar_angles(points1, points2, E).max() < 1e-12
    for p, q in zip(points1, points2, strict=True):
        normal = np.cross(T, R @ [*p, 1])
        normal /= np.linalg.norm(normal)
        ray = np.array([*q, 1]) / np.linalg.norm([*q, 1])
        raised = math.cos(0.01) * ray + math.sin(0.01) * normal
        moved = raised[:2] / raised[2]
        angle = epipolar_angles(p[None], moved[None], E)[0]
        assert angle == pytest.approx(0.01, abs=1e-9)
