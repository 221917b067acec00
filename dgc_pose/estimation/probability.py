"""The probability that a pose is right, and its expected error, from all the evidence.

A logistic model of a few features, fitted by `dgc-pose fit-probability`. `probability.json` holds a
model for each kind of matches; `probability.md` beside it is the card: data, split, figures.
"""

import json
import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from functools import cache
from importlib.resources import files
from statistics import NormalDist
from typing import Literal, NamedTuple

import numpy as np

from dgc_pose.estimation.covariance import NORMAL_90
from dgc_pose.estimation.evidence import Evidence

RIGHT_DEG = 10.0  # a pose is right if R and t are both off by no more
FORMAT = 5  # of the file
MatchKind = Literal["network", "matches", "key_points", "network_auto", "matches_auto"]
_MAX_REASONS = 3
_FEWER_TWO_PLACES = math.log((0.98 / 0.02) / (0.92 / 0.08))  # 2 % in place of 8 %
DOUBTFUL = 0.8  # probability that both images show one place, below which it is a reason
# A belief that is wrong of the focal length is so for all pairs of a camera, and what is fitted on
# pairs is too sure: of log-odds, where the error of ln f at nine in ten, per cent, is the second.
_OPEN_LOG_ODDS, _OPEN_FOCAL_PERCENT = math.log(9.0), (15.0, 40.0)
_MAX_LOG_FACTOR = 4.0  # of the calibrated error over the raw one


def match_kind(*, key_points: bool, with_map: bool, fitted: bool) -> MatchKind:
    """Which model applies: of matches with a dense map, without one, or of key points; `_auto` if
    the focal lengths are fitted."""
    if key_points:
        return "key_points"
    if fitted:
        return "network_auto" if with_map else "matches_auto"
    return "network" if with_map else "matches"


class Feature(NamedTuple):
    """A number made of the evidence; the logistic model is linear in it."""

    field: str  # of the evidence
    sign: int  # of its weight: 1 if more of it speaks for the pose, -1 if against
    # What speaks against a pose that has little, or much, of it; formats the value, and e, the
    # evidence.
    against: str
    # The logarithm is taken within this range, so that the model never extrapolates; None: the
    # number itself, a share of at most 1.
    log_range: tuple[float, float] | None = None

    def value(self, evidence: Evidence) -> float:
        """The number."""
        number: float | None = getattr(evidence, self.field)
        if self.log_range is None:
            return min(number or 0.0, 1.0)
        return _log(number, *self.log_range)

    def words(self, evidence: Evidence) -> str:
        """`against` for this evidence."""
        value = getattr(evidence, self.field)
        return self.against.format(value, e=evidence).replace("%", " %")


def _log(value: float | None, low: float, high: float) -> float:
    return math.log(min(max(high if value is None else value, low), high))


FEATURES: Mapping[str, Feature] = {
    "inlier_ratio": Feature("inlier_ratio", 1, "only {:.0%} of the matches are inliers"),
    "over_chance": Feature(
        "over_chance", 1, "{e.chance_ratio:.0%} of wrong matches agree as well", (1, 100)
    ),
    "cheirality": Feature(
        "cheirality_ratio", 1, "only {:.0%} of the inliers lie in front of both cameras"
    ),
    "occupied_cells": Feature(
        "occupied_cells", 1, "the inliers lie in only {} grid cells", (3, 400)
    ),
    "rotation_error": Feature(
        "raw_rotation_90_deg", -1, "the inliers hardly determine the rotation", (0.02, 60)
    ),
    "translation_error": Feature(
        "raw_translation_90_deg", -1, "the inliers hardly determine the translation", (0.05, 120)
    ),
    "residual": Feature("residual", -1, "the inliers do not agree closely"),
    "threshold": Feature("threshold_cells", -1, "the matches are inaccurate", (0.01, 0.5)),
    "parallax": Feature("parallax", 1, "there is little parallax", (0.7, 40)),
    "rotation_share": Feature("rotation_share", -1, "a rotation explains most matches"),
    "triangulation": Feature(
        "median_triangulation_angle_deg", 1, "small triangulation angles ({:.1f} deg)", (0.2, 30)
    ),
    "homography": Feature("homography_ratio", -1, "one homography explains {:.0%} of the inliers"),
    "confidence": Feature("confidence", 1, "the matched patches are not alike"),
    "rival": Feature("other_ratio", -1, "another pose has {:.0%} as many inliers"),
    "matchability": Feature("map_matchability", 1, "the dense map is hardly matchable"),
    "map_agreement": Feature("map_agreement", 1, "only {:.0%} of the dense map agrees with it"),
    "map_over_chance": Feature(
        "map_over_chance", 1, "the dense map agrees with it no more than by chance"
    ),
    "camera_agreement": Feature("camera_agreement", 1, "other cameras explain the matches too"),
    "focal_error": Feature(
        "raw_focal_90_percent", -1, "the matches hardly determine the focal length", (0.3, 100)
    ),
}
OF_AUTO = ("camera_agreement", "focal_error")  # of focal lengths that are fitted
OF_MAPS = ("matchability", "map_agreement", "map_over_chance")


CHOICE_FEATURES = ("likelihood", "map_agreement")


@dataclass(frozen=True)
class ErrorModel:
    """The error that nine right poses in ten stay below, from the raw error: a power of it.

    The raw error is that of the covariance, which does not have all that the errors of neighbouring
    matches have in common.
    """

    slope: float
    intercept: float

    def factor(self, error_deg: float) -> float:
        """By which the raw error (at nine in ten, degrees) is scaled."""
        total = self.intercept + self.slope * log_error(error_deg)
        return math.exp(min(max(total, -_MAX_LOG_FACTOR), _MAX_LOG_FACTOR))


def log_error(error_deg: float) -> float:
    """The logarithm of a raw error, in degrees or of a focal length in per cent, within the
    range that the model was fitted on."""
    return _log(error_deg, 0.005, 60)


@dataclass(frozen=True)
class SamePlace:
    """The probability that images whose matches have a pose show one place, and not two that have a
    part alike: logistic in how alike what surrounds the matches is."""

    slope: float
    intercept: float

    def probability(self, evidence: Evidence) -> float:
        """1 if what surrounds the matches is not known. Fewer of the pairs that people give are of
        two places than of those that it is fitted on."""
        if evidence.surroundings is None:
            return 1.0
        log_odds = self.intercept + self.slope * evidence.surroundings + _FEWER_TWO_PLACES
        return 1 / (1 + math.exp(-log_odds))


@dataclass(frozen=True)
class ProbabilityModel:
    """The two steps of the probability for one kind of matches: a logistic model of whether a right
    pose is among those that explain the matches, and which of them it is."""

    weights: Mapping[str, float]  # log-odds for a unit of each feature
    intercept: float
    reference: Mapping[str, float]  # the median of each feature over right poses
    rotation_error: ErrorModel
    translation_error: ErrorModel
    choice: Mapping[str, float]  # log-odds for a unit of each of `CHOICE_FEATURES`, and "lapse"
    same_place: SamePlace

    def probability(self, evidence: Evidence) -> float:
        """The probability that a pose with R and t within 10 degrees is among those that explain
        the matches.

        evidence: of the likeliest of them. The model is fitted on poses of images of one place, see
        `same_place`. It is at most the probability that other cameras and the expected errors
        leave.
        """
        total = self.intercept + sum(
            weight * FEATURES[name].value(evidence) for name, weight in self.weights.items()
        )
        # How far a belief decides on the focal length, and not the matches: 0 to 1.
        low, high = _OPEN_FOCAL_PERCENT
        error = _log(evidence.raw_focal_90_percent or low, low, high)
        total -= _OPEN_LOG_ODDS * ((error - math.log(low)) / math.log(high / low))
        fitted = 1 / (1 + math.exp(-min(max(total, -30.0), 30.0)))
        within = map(_within, self.errors_90_deg(evidence))
        return min(fitted, evidence.camera_agreement, *within)

    def against(self, evidence: Evidence) -> list[str]:
        """Reasons against the pose: the features that cost most log-odds, compared with their
        medians over right poses, most first."""
        costs = {
            name: weight * (self.reference[name] - FEATURES[name].value(evidence))
            for name, weight in self.weights.items()
        }
        worst = sorted((name for name in costs if costs[name] > 0), key=lambda n: -costs[n])
        words = [FEATURES[name].words(evidence) for name in worst[:_MAX_REASONS]]
        if self.same_place.probability(evidence) >= DOUBTFUL:
            return words
        return [
            "the surroundings of the matches differ between the images",
            *words[: _MAX_REASONS - 1],
        ]

    def calibrated(self, covariance: np.ndarray, evidence: Evidence) -> np.ndarray:
        """The covariance (6, 6) of a pose scaled so that its error holds nine times in ten if the
        pose is right, which is an error of at most 10 degrees."""
        raw = evidence.raw_rotation_90_deg, evidence.raw_translation_90_deg
        factors = [
            of_right(error) / before if before else 1.0
            for error, before in zip(self.errors_90_deg(evidence), raw, strict=True)
        ]
        scale = np.repeat(factors, 3)
        return covariance * np.outer(scale, scale)

    def errors_90_deg(self, evidence: Evidence) -> tuple[float, float]:
        """The calibrated errors of R and t, at nine in ten, of a pose that may be wrong as well; 0
        where there is no raw error."""
        rotation = evidence.raw_rotation_90_deg or 0.0
        translation = evidence.raw_translation_90_deg or 0.0
        return (
            rotation * self.rotation_error.factor(rotation),
            translation * self.translation_error.factor(translation),
        )


class FittedModels(NamedTuple):
    """The models that `dgc-pose fit-probability` fits."""

    by_kind: Mapping[str, ProbabilityModel]  # a `MatchKind` each
    focal_error: ErrorModel  # of the logarithm of a focal length that was fitted, per cent
    weights: frozenset[str]  # fingerprints of the networks whose matches they are fitted on

    def model(
        self, weights: str | None, *, key_points: bool, with_map: bool, fitted: bool
    ) -> ProbabilityModel | None:
        """The model of matches, see `match_kind`; None if none is fitted for such matches. weights:
        of `Matches`. Those of key points are of any detector."""
        if not key_points and weights not in self.weights:
            return None
        return self.by_kind.get(match_kind(key_points=key_points, with_map=with_map, fitted=fitted))


@cache
def shipped_models() -> FittedModels:
    """The models of the package."""
    file = files("dgc_pose.estimation").joinpath("probability.json")
    return parse_models(file.read_text("utf-8"))


def parse_models(text: str) -> FittedModels:
    """The models in the JSON that `dgc-pose fit-probability` writes."""
    data = json.loads(text)
    models = {
        kind: ProbabilityModel(
            values["weights"],
            values["intercept"],
            values["reference"],
            ErrorModel(**values["rotation_error"]),
            ErrorModel(**values["translation_error"]),
            values["choice"],
            SamePlace(**data["same_place"]),
        )
        for kind, values in data["models"].items()
    }
    weights = frozenset(e["fingerprint"] for e in data["engine"].values() if e["fingerprint"])
    return FittedModels(models, ErrorModel(**data["focal_error"]), weights)


def calibrated_focal_std(std: float) -> float:
    """The standard deviation of ln f, from the raw one, which may be infinite. Raw ones below a per
    cent, which few of the scenes fitted on have, are scaled as that is."""
    return std * shipped_models().focal_error.factor(max(100 * NORMAL_90 * std, 1.0))


def of_right(error_90_deg: float) -> float:
    """What a normal error stays below nine times in ten if it is at most `RIGHT_DEG`, by the same
    without that condition."""
    share = 0.9 * _within(error_90_deg)
    return error_90_deg / NORMAL_90 * NormalDist().inv_cdf((1 + share) / 2)


def _within(error_90_deg: float) -> float:
    """The probability that a normal error is at most `RIGHT_DEG`, by what it stays below nine times
    in ten."""
    return math.erf(NORMAL_90 * RIGHT_DEG / max(error_90_deg, 1e-9) / math.sqrt(2))


def utility(likelihood: float, map_agreement: float | None, weights: Mapping[str, float]) -> float:
    """The log-odds of a hypothesis, up to a constant of the pair."""
    values = {"likelihood": likelihood, "map_agreement": map_agreement or 0.0}
    return sum(weights[name] * values[name] for name in CHOICE_FEATURES if name in weights)


def choice_shares(utilities: Sequence[float] | np.ndarray, lapse: float = 0.0) -> np.ndarray:
    """Probabilities (K,) of the conditional logit model (McFadden 1974) of utilities (K,), -inf for
    what cannot be chosen. lapse: the probability that any other is right, whatever these state."""
    values = np.asarray(utilities)
    odds = np.exp(values - values.max())
    possible = np.isfinite(values)
    return (1 - lapse) * odds / odds.sum() + lapse * possible / possible.sum()
