"""How surprising a model's inliers are: random matches have inliers as well."""

from __future__ import annotations

import math

import numpy as np
from scipy.special import gammaln

from dgc_pose.estimation.backends import MINIMAL
from dgc_pose.geometry.epipolar import sampson_distance

_PAIRS = 20_000  # wrong pairs that the chance level is measured on, where there are so many
_ROUNDS = 8  # at least, in each of which a point has another wrong partner


def chance_ratio(
    points1: np.ndarray, points2: np.ndarray, E: np.ndarray, threshold: float, seed: int
) -> float:
    """The inlier ratio that an essential matrix gets of points (N, 2) paired wrongly.

    Points and threshold are normalised. The points keep their places, so the width of the band
    around the epipolar lines, the size of the images and matches that crowd in one spot all count.
    """
    count = len(points1)
    if count < 2:
        return 1.0
    order = np.random.default_rng(seed).permutation(count)[: _PAIRS // _ROUNDS]
    count = len(order)
    rounds = min(count - 1, max(_ROUNDS, math.ceil(_PAIRS / count)))
    hits = 0
    for shift in range(1, rounds + 1):
        wrong = np.roll(order, shift)  # never a point with its own match
        hits += int((sampson_distance(points1[order], points2[wrong], E) < threshold).sum())
    return (hits + 1) / (rounds * count + 1)


def log10_false_alarms(count: int, inliers: int, chance: float) -> float:
    """Decimal logarithm of how many models of random matches would have so many inliers.

    (n - 5) C(n, k) C(k, 5) p^(k - 5): all the samples that RANSAC could have drawn, times the
    probability that so many of the other matches agree by chance (Moisan and Stival, 2004).
    """
    if inliers <= MINIMAL or inliers > count:
        return math.inf
    tests = math.log(max(count - MINIMAL, 1)) + _log_choose(count, inliers)
    alarms = tests + _log_choose(inliers, MINIMAL) + (inliers - MINIMAL) * math.log(chance)
    return alarms / math.log(10)


def _log_choose(count: int, chosen: int) -> float:
    return float(gammaln(count + 1) - gammaln(chosen + 1) - gammaln(count - chosen + 1))
