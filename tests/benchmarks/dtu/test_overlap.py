from __future__ import annotations

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from dgc_pose.benchmarks.dtu.calibration import DtuView
from dgc_pose.benchmarks.dtu.overlap import overlap

SIZE = (1600, 1200)
K = np.array([[2890.0, 0.0, 799.5], [0.0, 2890.0, 599.5], [0.0, 0.0, 1.0]])


def turned(degrees, axis="y"):
    return DtuView(K, Rotation.from_euler(axis, degrees, degrees=True).as_matrix(), np.zeros(3))


def test_a_view_sees_all_that_it_sees():
    assert overlap(turned(0), turned(0), SIZE) == 1


def test_opposite_views_see_nothing_in_common():
    assert overlap(turned(0), turned(180), SIZE) == 0


def test_a_turn_by_half_the_field_of_view_halves_the_overlap():
    # The image ends 800 px from its middle: this turn takes the middle to the edge.
    half = np.degrees(np.arctan(800 / 2890))
    assert overlap(turned(0), turned(half), SIZE) == pytest.approx(0.5, abs=0.05)


def test_overlap_falls_with_the_baseline():
    shares = [
        overlap(turned(0), DtuView(K, np.eye(3), np.array([shift, 0.0, 0.0])), SIZE)
        for shift in (0.0, 50.0, 100.0, 200.0)
    ]
    assert shares == sorted(shares, reverse=True)
    # Beyond the width of the view at the greatest depth, 935 mm * 1600 / 2890, nothing is shared.
    assert overlap(turned(0), DtuView(K, np.eye(3), np.array([520.0, 0.0, 0.0])), SIZE) == 0
