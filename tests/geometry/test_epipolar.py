import math

import cv2
import numpy as np
import pycolmap
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from scenes import assert_among, two_view_scene
from scipy.spatial.transform import Rotation

from dgc_pose.geometry.epipolar import (
    essential_from_pose,
    fundamental_from_essential,
    pose_candidates,
    sampson_distance,
    symmetric_epipolar_distance,
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
