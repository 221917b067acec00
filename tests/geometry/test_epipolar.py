import math

import cv2
import numpy as np
import pycolmap
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from scenes import assert_among, two_view_scene
from scipy.optimize import least_squares
from scipy.spatial.transform import Rotation

from dgc_pose.geometry.epipolar import (
    depths,
    epipolar_angles,
    essential_from_pose,
    fundamental_from_essential,
    pose_candidates,
    sampson_distance,
    symmetric_epipolar_distance,
    triangulation_angles_deg,
)

seeds = st.integers(0, 2**32 - 1)


def random_pose(seed):
    rng = np.random.default_rng(seed)
    t = rng.standard_normal(3)
    return Rotation.random(random_state=rng).as_matrix(), t / np.linalg.norm(t)


def pixel_scene():
    """Matches up to some pixels off, and their F."""
    scene = two_view_scene("general", seed=1, count=40, sigma_px=4.0, outliers=0.0)
    E = essential_from_pose(scene.R, scene.t)
    return scene, fundamental_from_essential(E, scene.K1, scene.K2)


@given(seeds)
@settings(max_examples=25, deadline=None)
def test_the_essential_matrix_annuls_exact_points_and_is_pycolmaps(seed):
    R, t = random_pose(seed)
    E = essential_from_pose(R, t)
    X1 = np.random.default_rng(seed).standard_normal((10, 3))
    X2 = X1 @ R.T + t
    assert np.abs(np.einsum("ni,ij,nj->n", X2, E, X1)).max() < 1e-12
    theirs = pycolmap.essential_matrix_from_pose(pycolmap.Rigid3d(pycolmap.Rotation3d(R), t))
    np.testing.assert_allclose(E, theirs, atol=1e-12)


@given(seeds, st.floats(-1e3, 1e3).filter(lambda s: abs(s) > 1e-3))
@settings(max_examples=25, deadline=None)
def test_the_true_pose_is_one_of_four_whatever_the_scale_of_the_essential_matrix(seed, scale):
    R, t = random_pose(seed)
    candidates = pose_candidates(scale * essential_from_pose(R, t))
    assert len(candidates) == 4
    assert_among(candidates, R, t, 1e-7)


def test_the_sampson_distance_is_opencvs():
    scene, F = pixel_scene()
    found = sampson_distance(scene.points1, scene.points2, F)
    for p, q, distance in zip(scene.points1, scene.points2, found, strict=True):
        squared = cv2.sampsonDistance(np.array([*p, 1.0]), np.array([*q, 1.0]), F)
        assert distance == pytest.approx(math.sqrt(squared), rel=1e-9)


def test_a_match_of_both_epipoles_is_at_distance_zero_and_not_nan():
    E = essential_from_pose(np.eye(3), np.array([0.0, 0, 1]))
    epipole = np.zeros((1, 2))
    assert sampson_distance(epipole, epipole, E) == 0
    assert symmetric_epipolar_distance(epipole, epipole, E) == 0


R = Rotation.from_rotvec([0.1, -0.3, 0.05]).as_matrix()
T = np.array([1.0, 0.2, -0.1]) / np.linalg.norm([1.0, 0.2, -0.1])


def _seen(X):
    """Points (N, 3) in camera 1's frame as both cameras see them, and in camera 2's frame."""
    local = X @ R.T + T
    return X[:, :2] / X[:, 2:], local[:, :2] / local[:, 2:], local


POINTS = np.random.default_rng(0).uniform(-2, 2, (10, 3)) + (0, 0, 6)


def test_depths_are_those_of_the_nearest_ends_of_the_rays_behind_a_camera_too():
    X = np.vstack([POINTS, (0.5, 0.2, -4.0)])
    points1, points2, local = _seen(X)
    np.testing.assert_allclose(depths(points1, points2, R, T), (X[:, 2], local[:, 2]), rtol=1e-6)
    points2 = points2 + 0.01 * np.random.default_rng(1).standard_normal(points2.shape)
    for p, q, d1, d2 in zip(points1, points2, *depths(points1, points2, R, T), strict=True):
        gap = least_squares(
            lambda d, p=p, q=q: d[0] * (R @ [*p, 1]) + T - d[1] * np.array([*q, 1]), [1, 1]
        )
        np.testing.assert_allclose([d1, d2], gap.x, rtol=1e-5)


def test_parallel_rays_meet_at_infinity_and_not_at_nan():
    points = np.array([[0.0, 0.0], [0.3, -0.2]])
    assert (np.abs(depths(points, points, np.eye(3), np.array([1.0, 0, 0]))) > 1e12).all()


def test_the_triangulation_angle_is_seen_from_the_point():
    points1, points2, _ = _seen(POINTS)
    found = triangulation_angles_deg(points1, points2, R)
    for point, angle in zip(POINTS, found, strict=True):
        a, b = -point, -R.T @ T - point
        expected = math.acos(a @ b / np.linalg.norm(a) / np.linalg.norm(b))
        assert angle == pytest.approx(math.degrees(expected), abs=1e-6)


def test_the_epipolar_angle_is_the_rotation_that_brings_ray_2_into_the_plane():
    points1, points2, local = _seen(POINTS)
    E = essential_from_pose(R, T)
    assert epipolar_angles(points1, points2, E).max() < 1e-12
    normals = np.cross(T, points1 @ R[:, :2].T + R[:, 2])
    normals /= np.linalg.norm(normals, axis=1, keepdims=True)
    rays = local / np.linalg.norm(local, axis=1, keepdims=True)
    raised = math.cos(0.01) * rays + math.sin(0.01) * normals
    angles = epipolar_angles(points1, raised[:, :2] / raised[:, 2:], E)
    np.testing.assert_allclose(angles, 0.01, atol=1e-9)
