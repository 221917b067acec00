import math

import cv2
import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from scenes import assert_among
from scipy.spatial.transform import Rotation

from dgc_pose.geometry.homography import fit_homography, homography_poses, transfer_error

H = np.array([[1.1, 0.1, 0.02], [-0.08, 0.95, -0.1], [0.1, -0.05, 1.0]])


def moved(points, H):
    return cv2.perspectiveTransform(points[None], H)[0]


def test_the_fit_finds_a_homography_among_outliers_and_repeats_to_the_bit():
    rng = np.random.default_rng(0)
    points1 = rng.uniform(-0.5, 0.5, (300, 2))
    points2 = moved(points1, H) + 1e-3 * rng.standard_normal((300, 2))
    points2[:120] = rng.uniform(-0.5, 0.5, (120, 2))
    found = fit_homography(points1, points2, 4e-3, seed=3)
    np.testing.assert_allclose(moved(points1, found), moved(points1, H), atol=2e-3)
    assert np.array_equal(found, fit_homography(points1, points2, 4e-3, seed=3))
    assert fit_homography(points1, points2, 4e-3, seed=2**40 + 3) is not None  # any seed will do


@pytest.mark.parametrize(
    "points",
    [np.zeros((0, 2)), np.array([[0, 0], [1, 0], [0, 1.0]]), np.tile([[0.1, 0.2]], (30, 1))],
    ids=["none", "three", "all alike"],
)
def test_degenerate_points_have_no_homography_and_raise_nothing(points):
    assert fit_homography(points, points, 1e-3) is None


def test_the_transfer_error_is_the_distance_in_image_2():
    rng = np.random.default_rng(0)
    points1, points2 = rng.uniform(-1, 1, (2, 20, 2))
    found = transfer_error(points1, points2, H)
    for p, q, error in zip(moved(points1, H), points2, found, strict=True):
        assert error == pytest.approx(math.dist(p, q))
    horizon = np.array([[1.0, 0, 0], [0, 1, 0], [1, 0, 0]])
    assert transfer_error(np.zeros((1, 2)), np.zeros((1, 2)), horizon)[0] == math.inf


@given(st.integers(0, 2**32 - 1), st.sampled_from([1.0, -1.0, 2.5, -0.3]))
@settings(max_examples=50, deadline=None)
def test_the_true_pose_is_among_a_planes_whatever_the_scale_and_sign_of_the_homography(seed, scale):
    rng = np.random.default_rng(seed)
    R = Rotation.from_rotvec(rng.uniform(-1, 1, 3)).as_matrix()
    normal = np.array([0, 0, 1]) + rng.uniform(-0.5, 0.5, 3)
    normal /= np.linalg.norm(normal)
    t = rng.uniform(-1, 1, 3)
    plane = R + np.outer(t, normal) / 4  # both cameras on one side: |t| < 4
    assert_among(homography_poses(scale * plane), R, t / np.linalg.norm(t), 1e-5)


def test_a_rotation_is_no_plane():
    assert homography_poses(Rotation.from_rotvec([0.1, 0.2, 0.3]).as_matrix()) == []
