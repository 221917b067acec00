"""Which of several poses is the right one, if one of them is: the second step of the probability.

A plane has two poses with nearly the same inliers, and their counts do not decide which is right.
The likelihood of all matches does better. Errors of neighbouring matches are alike, so a difference
of log-likelihoods counts by the square root of the number of matches.
"""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from typing import Protocol

import numpy as np

from dgc_pose.estimation.evidence import map_agreement
from dgc_pose.estimation.model import Model, pose_error_scale
from dgc_pose.estimation.options import EstimationOptions
from dgc_pose.estimation.problem import TwoViewProblem
from dgc_pose.estimation.refine import refit
from dgc_pose.estimation.rivals import known
from dgc_pose.estimation.texts import probability_text, short_text
from dgc_pose.geometry.epipolar import sampson_distance

# Inliers of another pose, over the first one's, at which it explains the matches about as well.
ALTERNATIVE_SHARE = 0.75
_FARTHEST = 3.0  # thresholds; larger errors, and points behind a camera, count as this
CHOICE_FEATURES = ("likelihood", "map_agreement")


class Choosable(Protocol):
    """What the choice among poses rests on."""

    @property
    def likelihood(self) -> float:
        """Logarithm of that of all matches, over the root of the number of inliers."""

    @property
    def map_agreement(self) -> float | None:
        """Share of the dense map that agrees, by matchability; None without a map."""


@dataclass(frozen=True, eq=False)
class Hypothesis:
    """A pose that explains matches, and what the choice among several rests on (a `Choosable`).

    Attributes:
        model: The pose, and its inliers.
        likely: Whether it explains the matches about as well as the first.
        likelihood: Logarithm of the likelihood of all matches, over the root of the number of
            inliers.
        map_agreement: Share of the dense map that agrees, by matchability; None without a map.
        share: The probability that it is right if one is; 0 if it is not likely.
        probability: Probability that R and t are both within 10 degrees of the truth; None if no
            model of it is fitted for such matches, and before the verdict.
    """

    model: Model
    likely: bool
    likelihood: float
    map_agreement: float | None
    share: float = math.nan
    probability: float | None = None

    def __repr__(self) -> str:
        R, t = short_text(self.R), short_text(self.t)
        likely = probability_text(self.probability)
        return f"Hypothesis(R={R}, t={t}, {self.num_inliers} inliers, {likely})"

    @property
    def R(self) -> np.ndarray:
        """Rotation (3, 3) from camera 1 to camera 2."""
        return self.model.R

    @property
    def t(self) -> np.ndarray:
        """Direction (3,) of the translation, unit length, in camera 2's axes."""
        return self.model.t

    @property
    def num_inliers(self) -> int:
        """Number of matches that it explains."""
        return self.model.count


def hypotheses(
    problem: TwoViewProblem,
    first: Model,
    others: Sequence[Model],
    map_problem: TwoViewProblem | None,
    options: EstimationOptions,
) -> list[Hypothesis]:
    """Make hypotheses of the model with most inliers, whose errors show how accurate the matches
    are, and of others; those that are likely have their last fit, if it is still another pose.

    map_problem: an even sample of the dense map.
    """
    inliers = problem.subset(first.inliers)
    scale = pose_error_scale(inliers, first.R, first.t) if len(inliers) else problem.threshold
    root = math.sqrt(max(first.count_in_front, 1))
    least = ALTERNATIVE_SHARE * first.count_in_front
    result: list[Hypothesis] = []
    for number, model in enumerate((first, *others)):
        likely = number == 0 or model.count_in_front >= least
        if likely and number and options.refine:
            fitted = refit(problem, model, adapt_scale=True)
            # A fit may lead to another of the models, or to that with t reversed.
            rest = [*(hypothesis.model for hypothesis in result), *others[number:]]
            if fitted.count_in_front >= least and not known(fitted, rest):
                model = fitted  # noqa: PLW2901
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
    odds = [utility(h, weights) if h.likely else -math.inf for h in among]
    shares = choice_shares(odds).tolist()
    valued = [replace(h, share=share) for h, share in zip(among, shares, strict=True)]
    return sorted(valued, key=lambda h: -h.share)


def utility(pose: Choosable, weights: Mapping[str, float]) -> float:
    """The log-odds of a pose, up to a constant of the pair."""
    values = {"likelihood": pose.likelihood, "map_agreement": pose.map_agreement or 0.0}
    return sum(weight * values[name] for name, weight in weights.items())


def choice_shares(utilities: Sequence[float] | np.ndarray) -> np.ndarray:
    """Probabilities (K,) of the conditional logit model (McFadden 1974) of utilities (K,)."""
    values = np.asarray(utilities)
    odds = np.exp(values - values.max())
    return odds / odds.sum()


def _log_likelihoods(problem: TwoViewProblem, model: Model, scale: float) -> np.ndarray:
    """Of each match (N,), up to a constant: that of the Cauchy distribution, cut off."""
    farthest = _FARTHEST * problem.threshold
    error = sampson_distance(problem.points1, problem.points2, model.E)
    error = np.where(model.in_front, np.minimum(error, farthest), farthest)
    return -np.log1p((error / scale) ** 2)
