"""Which of several poses is the right one, if one of them is: the second step of the probability.

A plane has two poses with nearly the same inliers, and their counts do not tell which is right. The
likelihood of all matches tells more. Errors of neighbouring matches are alike, so a difference of
log-likelihoods counts by the square root of the number of matches.
"""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace

import numpy as np

from dgc_pose.estimation.evidence import map_agreement
from dgc_pose.estimation.model import Model, pose_error_scale
from dgc_pose.estimation.options import EstimationOptions
from dgc_pose.estimation.problem import TwoViewProblem
from dgc_pose.estimation.refine import refit
from dgc_pose.geometry.epipolar import sampson_distance

_FARTHEST = (
    3.0  # thresholds; of a larger error, and of a point behind a camera, the likelihood ends
)
CHOICE_FEATURES = ("likelihood", "map_agreement")


@dataclass(frozen=True, eq=False)
class Hypothesis:
    """A pose, and what the choice among several rests on."""

    model: Model
    likely: bool  # whether it explains the matches about as well as the first
    likelihood: float  # of all matches, its logarithm over the root of the number of inliers
    map_agreement: float | None  # share of the dense map that agrees, by matchability; None without
    share: float = math.nan  # the probability that it is right if one is; 0 if it is not likely

    def feature(self, name: str) -> float:
        """The value of one of `CHOICE_FEATURES`."""
        value: float | None = getattr(self, name)
        return 0.0 if value is None else value


def hypotheses(
    problem: TwoViewProblem,
    first: Model,
    others: Sequence[Model],
    map_problem: TwoViewProblem | None,
    options: EstimationOptions,
) -> list[Hypothesis]:
    """Those of the model with most inliers, whose errors say how accurate the matches are, and of
    others, those of which that are likely with their last fit.

    map_problem: an even sample of the dense map.
    """
    inliers = problem.subset(first.inliers)
    scale = pose_error_scale(inliers, first.R, first.t) if len(inliers) else problem.threshold
    root = math.sqrt(max(first.count_in_front, 1))
    least = options.verdict.alternative_share * first.count_in_front
    result = []
    for number, model in enumerate((first, *others)):
        likely = number == 0 or model.count_in_front >= least
        if likely and number and options.refine:
            model = refit(problem, model, adapt_scale=True)  # noqa: PLW2901
        likelihood = float(_log_likelihoods(problem, model, scale).sum()) / root
        agreement = None if map_problem is None else map_agreement(map_problem, model)
        result.append(Hypothesis(model, likely, likelihood, agreement))
    return result


def ranked(among: Sequence[Hypothesis], weights: Mapping[str, float] | None) -> list[Hypothesis]:
    """Hypotheses with their shares, the likeliest first; without weights as they are.

    weights: log-odds for a unit of each of `CHOICE_FEATURES`.
    """
    if weights is None:
        return list(among)
    shares = choice_shares(
        [sum(weight * h.feature(name) for name, weight in weights.items()) for h in among],
        [h.likely for h in among],
    )
    valued = [replace(h, share=float(share)) for h, share in zip(among, shares, strict=True)]
    return sorted(valued, key=lambda h: -h.share)


def choice_shares(utility: Sequence[float], likely: Sequence[bool]) -> np.ndarray:
    """Probabilities (K,) of a conditional logit model (McFadden 1974) among those that are likely.

    utility: (K,) log-odds.
    """
    values = np.where(likely, utility, -np.inf)
    odds = np.exp(values - values.max())
    return odds / odds.sum()


def _log_likelihoods(problem: TwoViewProblem, model: Model, scale: float) -> np.ndarray:
    """Of each match (N,), up to a constant: that of the Cauchy distribution, cut off."""
    farthest = _FARTHEST * problem.threshold
    error = sampson_distance(problem.points1, problem.points2, model.E)
    error = np.where(model.in_front, np.minimum(error, farthest), farthest)
    return -np.log1p((error / scale) ** 2)
