"""Quantiles of the chi-square distribution, for any number of degrees of freedom.

SciPy has them, and its import takes longer than a pose: what `estimate` runs does without it.
"""

from __future__ import annotations

import math

_STEPS = 100  # of Newton's method at most; about six are needed
_TOLERANCE = 1e-14  # relative


def chi_square_quantile(freedom: float, share: float) -> float:
    """The value that a chi-square variable stays below with probability `share`.

    freedom: degrees, above 0 and at most some hundred; share: above 0, below 1.
    """
    half = value = freedom / 2
    for _ in range(_STEPS):
        slope = math.exp((half - 1) * math.log(value) - value - math.lgamma(half))
        # Left of the mode a step may lead below 0.
        following = max(value - (_incomplete_gamma(half, value) - share) / slope, value / 8)
        if abs(following - value) <= _TOLERANCE * value:
            break
        value = following
    return 2 * following


def _incomplete_gamma(a: float, x: float) -> float:
    """The regularised lower incomplete gamma function P(a, x), by its series (DLMF 8.7.1)."""
    term = total = math.exp(a * math.log(x) - x - math.lgamma(a + 1))
    count = a
    while term > 1e-17 * total:
        count += 1
        term *= x / count
        total += term
    return total
