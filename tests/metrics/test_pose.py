"""Pose errors and their AUC, against scipy's rotations and a curve integrated by brute force."""

import math

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from scipy.spatial.transform import Rotation

from dgc_pose.errors import InputError
from dgc_pose.metrics import folded, pose_auc, rotation_error_deg, translation_error_deg

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
def test_translation_error_is_the_angle_whatever_the_lengths(
    seed: int, angle: float, length: float
) -> None:
    rng = np.random.default_rng(seed)
    a, b, _ = Rotation.random(rng=rng).as_matrix().T
    t = math.cos(math.radians(angle)) * a + math.sin(math.radians(angle)) * b
    assert translation_error_deg(length * t, 3 * a) == pytest.approx(angle, abs=1e-9)


def test_translation_error_tells_the_sign_and_the_folded_one_does_not() -> None:
    t = np.array([1.0, 2.0, 3.0])
    assert translation_error_deg(-t, t) == 180
    for error, expected in ((180.0, 0), (170.0, 10), (10.0, 10), (90.0, 90), (math.inf, math.inf)):
        assert folded(error) == expected


def test_auc_of_cases_done_by_hand() -> None:
    assert pose_auc([0, 0, 0]) == pytest.approx((100, 100, 100))
    assert pose_auc([math.inf, 90]) == (0, 0, 0)
    # One pair at 4 degrees: a triangle up to 4, level after it.
    assert pose_auc([4], (5, 8)) == pytest.approx((60, 75))
    # A failure beside it halves everything.
    assert pose_auc([math.inf, 4], (5, 8)) == pytest.approx((30, 37.5))


@given(st.lists(st.floats(0, 180) | st.just(math.inf), min_size=1, max_size=30), seeds)
def test_auc_ignores_the_order_stays_in_range_and_falls_with_a_failure(
    errors: list[float], seed: int
) -> None:
    auc = np.array(pose_auc(errors))
    assert np.all((auc >= 0) & (auc <= 100 + 1e-9))
    assert pose_auc(np.random.default_rng(seed).permutation(errors)) == tuple(auc)
    with_failure = np.array(pose_auc([*errors, math.inf]))
    np.testing.assert_allclose(with_failure, auc * len(errors) / (len(errors) + 1))


@pytest.mark.parametrize("errors", [[], [[1.0]], [math.nan], [-1.0]])
def test_auc_refuses_what_is_no_list_of_errors(errors: list) -> None:
    with pytest.raises(InputError, match="errors"):
        pose_auc(errors)
