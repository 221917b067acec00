"""Thin-plate splines against SciPy's, in double precision."""

import numpy as np
import pytest
import torch
from scipy.interpolate import RBFInterpolator

from dgc_pose.benchmarks.spline import TPS_KNOTS, thin_plate_spline


@pytest.mark.parametrize("spread", [0.0, 0.2, 1.0])
def test_a_spline_is_scipys(spread: float) -> None:
    rng = np.random.default_rng(3)
    knots = TPS_KNOTS.double().numpy()
    values = knots + spread * rng.normal(size=(4, 9, 2))
    points = rng.uniform(-1.5, 1.5, (4, 50, 2))
    spline = thin_plate_spline(TPS_KNOTS.double(), torch.from_numpy(values))
    found = spline(torch.from_numpy(points)).numpy()
    for own, targets, places in zip(found, values, points, strict=True):
        expected = RBFInterpolator(knots, targets, kernel="thin_plate_spline", degree=1)(places)
        np.testing.assert_allclose(own, expected, atol=1e-9)
