"""Quantiles against NumPy's."""

from __future__ import annotations

import numpy as np
import pytest

from dgc_pose.files.arrays import quantiles


@pytest.mark.parametrize("shape", [(1,), (2,), (17,), (30, 41)])
def test_quantiles_are_numpys(shape: tuple[int, ...]) -> None:
    values = np.random.default_rng(3).normal(size=shape).astype(np.float32)
    shares = (0.0, 0.02, 0.5, 0.75, 0.98, 1.0)
    expected = np.quantile(values.astype(np.float64), shares)
    np.testing.assert_allclose(quantiles(values, *shares), expected, atol=1e-6)
