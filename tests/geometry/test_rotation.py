import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from scipy.spatial.transform import Rotation

from dgc_pose.geometry.rotation import (
    aligning_rotation,
    is_rotation,
    rotation_angle_deg,
)

seeds = st.integers(0, 2**32 - 1)


@pytest.mark.parametrize("angle", [0.0, 1e-6, 1.0, 90.0, 179.999, 180.0])
def test_the_angle_of_a_rotation_is_the_one_it_was_made_with(angle):
    R = Rotation.from_rotvec(np.radians(angle) * np.array([0.6, 0.0, 0.8])).as_matrix()
    assert rotation_angle_deg(R) == pytest.approx(angle, abs=1e-6)


@given(seeds)
@settings(max_examples=50, deadline=None)
def test_a_rotation_is_told_from_other_matrices(seed):
    R = Rotation.random(random_state=seed).as_matrix()
    assert is_rotation(R) and is_rotation(np.round(R, 4))
    for other in (-R, R[:, ::-1], 1.01 * R, 1e200 * R, np.full((3, 3), np.nan), R * np.inf):
        with np.errstate(all="raise"):
            assert not is_rotation(other)


@given(seeds)
@settings(max_examples=50, deadline=None)
def test_the_aligning_rotation_is_scipys(seed):
    rng = np.random.default_rng(seed)
    rays1 = rng.normal(size=(20, 3))
    rays2 = rays1 @ Rotation.random(random_state=seed).as_matrix().T + rng.normal(size=(20, 3))
    expected = Rotation.align_vectors(rays2, rays1)[0].as_matrix()
    np.testing.assert_allclose(aligning_rotation(rays1, rays2), expected, atol=1e-9)


def test_mirrored_rays_are_aligned_by_a_rotation():
    rays = np.random.default_rng(3).normal(size=(10, 3))
    R = aligning_rotation(rays, rays * (1, 1, -1))
    np.testing.assert_allclose(R @ R.T, np.eye(3), atol=1e-12)
    assert np.linalg.det(R) == pytest.approx(1)
