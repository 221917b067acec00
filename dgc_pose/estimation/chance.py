"""How significant a model's inliers are: random matches have inliers as well."""

from __future__ import annotations

import math

import numpy as np

from dgc_pose.estimation.poselib_calls import MINIMAL
from dgc_pose.estimation.problem import TwoViewProblem
from dgc_pose.geometry.epipolar import sampson_distance

_PAIRS = 20_000  # wrong pairs that the chance level is measured on, if there are so many
_MIN_ROUNDS = 8  # in each a point has another wrong partner


def chance_ratio(problem: TwoViewProblem, E: np.ndarray) -> float:
    """The inlier ratio of an essential matrix on the same points, paired wrongly.

    The points themselves stay, so the measure includes the width of the band around the epipolar
    lines, the size of the images, and clusters of matches.
    """
    count = len(problem)
    if count < 2:
        return 1.0
    order = np.random.default_rng(problem.seed).permutation(count)[: _PAIRS // _MIN_ROUNDS]
    count = len(order)
    rounds = min(count - 1, max(_MIN_ROUNDS, math.ceil(_PAIRS / count)))
    hits = 0
    for shift in range(1, rounds + 1):
        wrong = np.roll(order, shift)  # never a point with its own match
        distance = sampson_distance(problem.points1[order], problem.points2[wrong], E)
        hits += int((distance < problem.threshold).sum())
    return (hits + 1) / (rounds * count + 1)


def log10_false_alarms(count: int, inliers: int, chance: float) -> float:
    """Decimal logarithm of the number of models with so many inliers expected in random matches.

    (n - 5) C(n, k) C(k, 5) p^(k - 5): all samples that RANSAC could have drawn, times the
    probability that so many of the other matches agree by chance (Moisan and Stival, 2004).
    """
    if inliers <= MINIMAL or inliers > count:
        return math.inf
    tests = math.log(max(count - MINIMAL, 1)) + _log_choose(count, inliers)
    alarms = tests + _log_choose(inliers, MINIMAL) + (inliers - MINIMAL) * math.log(chance)
    return alarms / math.log(10)


def _log_choose(count: int, chosen: int) -> float:
    return math.lgamma(count + 1) - math.lgamma(chosen + 1) - math.lgamma(count - chosen + 1)
