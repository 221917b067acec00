"""Quantiles of the chi-square distribution against SciPy's."""

from __future__ import annotations

import pytest
from scipy.stats import chi2

from dgc_pose.estimation.chi_square import chi_square_quantile


@pytest.mark.parametrize("share", [1e-6, 0.01, 0.1, 0.5, 0.9, 0.99, 0.999999])
@pytest.mark.parametrize("freedom", [0.3, 1.0, 1.7, 2.0, 3.0, 20.0, 150.0])
def test_the_quantile_is_scipys(freedom: float, share: float) -> None:
    found = chi_square_quantile(freedom, share)
    assert found == pytest.approx(chi2.ppf(share, freedom), rel=1e-9, abs=1e-300)
