"""The probability that a pose is right, and its expected error, from all the evidence.

A logistic model of a few features, fitted by `dgc-pose fit-probability`. `probability.json` has a
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
MatchKind = Literal[
    "network", "matches", "key_points", "network_auto", "matches_auto", "key_points_auto"
]
_MAX_REASONS = 2
# 8 % of the pairs of the fit show two places, and 2 % of the pairs in use.
_FEWER_TWO_PLACES = math.log((0.98 / 0.02) / (0.92 / 0.08))
DOUBTFUL = 0.8  # probability of one place below which it is a reason against the pose
# A wrong prior of the focal length is wrong for all pairs of a camera, so the fit is too certain.
# Log-odds to subtract, growing from 0 to all between these errors of ln f (nine cases of ten, %).
_PRIOR_FOCAL_LOG_ODDS = math.log(9.0)
_OPEN_FOCAL_PERCENT = (15.0, 40.0)
_MAX_LOG_FACTOR = 4.0  # of the calibrated error over the raw one


def match_kind(*, key_points: bool, with_map: bool, fitted: bool) -> MatchKind:
    """The kind of model for matches with a dense map, without one, or of key points; `_auto` if the
    focal lengths are fitted."""
    if key_points:
        return "key_points_auto" if fitted else "key_points"
    if fitted:
        return "network_auto" if with_map else "matches_auto"
    return "network" if with_map else "matches"


class Feature(NamedTuple):
    """A number computed from the evidence; the logistic model is linear in it."""

    field: str  # of the evidence
    sign: int  # of its weight: 1 if a larger number supports the pose, -1 if it opposes it
    # Reason against a pose with a bad number: a format of the value and of e, the evidence.
    against: str
    # The logarithm is taken within this range, so that the model never extrapolates. None: no
    # logarithm; the number is a share of at most 1.
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
        "over_chance", 1, "{e.chance_ratio:.0%} of wrong matches would agree too", (1, 100)
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
    "residual": Feature("residual", -1, "the epipolar errors of the inliers are large"),
    "threshold": Feature("threshold_cells", -1, "the matches are inaccurate", (0.01, 0.5)),
    "parallax": Feature("parallax", 1, "there is little parallax", (0.7, 40)),
    "rotation_share": Feature("rotation_share", -1, "a rotation explains most matches"),
    "triangulation": Feature(
        "median_triangulation_angle_deg", 1, "small triangulation angles ({:.1f} deg)", (0.2, 30)
    ),
    "homography": Feature("homography_ratio", -1, "one homography explains {:.0%} of the inliers"),
    "confidence": Feature("confidence", 1, "the matched patches differ"),
    "rival": Feature("other_ratio", -1, "another pose has {:.0%} as many inliers"),
    "matchability": Feature("map_matchability", 1, "little of the dense map is matchable"),
    "map_agreement": Feature("map_agreement", 1, "only {:.0%} of the dense map agrees with it"),
    "map_over_chance": Feature(
        "map_over_chance", 1, "the dense map agrees with it no more than by chance"
    ),
    "camera_agreement": Feature("camera_agreement", 1, "other cameras explain the matches too"),
    "focal_error": Feature(
        "raw_focal_90_percent", -1, "the matches hardly determine the focal length", (0.3, 100)
    ),
}
FITTED_FOCAL_FEATURES = ("camera_agreement", "focal_error")  # features of fitted focal lengths
MAP_FEATURES = ("matchability", "map_agreement", "map_over_chance")
# They depend on the matcher more than on the pose, so the model of key points does without.
MATCHER_FEATURES = ("confidence", "threshold")


CHOICE_FEATURES = ("likelihood", "map_agreement")


@dataclass(frozen=True)
class ErrorModel:
    """The calibration of an error: the bound for nine right poses in ten is a power of the raw one.

    The raw error is from the covariance, which contains only a part of the correlation between
    neighbouring matches.
    """

    slope: float
    intercept: float

    def factor(self, error_deg: float) -> float:
        """The factor of a raw error (in nine cases of ten, degrees)."""
        total = self.intercept + self.slope * log_error(error_deg)
        return math.exp(min(max(total, -_MAX_LOG_FACTOR), _MAX_LOG_FACTOR))


def log_error(error_deg: float) -> float:
    """The logarithm of a raw error, in degrees or of a focal length in per cent, within the
    range that the model was fitted on."""
    return _log(error_deg, 0.005, 60)


@dataclass(frozen=True)
class SamePlace:
    """The probability that images whose matches have a pose show one place, not two places with a
    similar part. It is logistic in the similarity of the images around the matches."""

    slope: float
    intercept: float

    def probability(self, evidence: Evidence) -> float:
        """The probability; 1 if the similarity is unknown. Pairs in use show two places less often
        than the pairs of the fit."""
        if evidence.context_ratio is None:
            return 1.0
        log_odds = self.intercept + self.slope * evidence.context_ratio + _FEWER_TWO_PLACES
        return _logistic(log_odds)


@dataclass(frozen=True)
class ProbabilityModel:
    """The two steps of the probability for one kind of matches: whether a right pose is among those
    that explain the matches, and which of them it is."""

    weights: Mapping[str, float]  # log-odds per unit of each feature
    intercept: float
    reference: Mapping[str, float]  # the median of each feature over right poses
    rotation_error: ErrorModel
    translation_error: ErrorModel
    choice: Mapping[str, float]  # log-odds per unit of each of `CHOICE_FEATURES`, and "lapse"
    same_place: SamePlace
    # Names of the matchers that the model of key points was tested on; () for others.
    tested: tuple[str, ...] = ()

    def probability(self, evidence: Evidence) -> float:
        """The probability that a pose with R and t within 10 degrees is among those that explain
        the matches.

        evidence: of the likeliest pose. The model is fitted on images of one place, see
        `same_place`. Upper bounds are the camera agreement, and the probabilities that normal
        errors with the expected sizes are within 10 degrees.
        """
        total = self.intercept + sum(
            weight * FEATURES[name].value(evidence) for name, weight in self.weights.items()
        )
        # How far the prior, not the matches, determines the focal length: 0 to 1.
        low, high = _OPEN_FOCAL_PERCENT
        error = _log(evidence.raw_focal_90_percent or low, low, high)
        total -= _PRIOR_FOCAL_LOG_ODDS * ((error - math.log(low)) / math.log(high / low))
        fitted = _logistic(total)
        within = map(_within, self.errors_90_deg(evidence))
        return min(fitted, evidence.camera_agreement, *within)

    def against(self, evidence: Evidence) -> list[str]:
        """Reasons against the pose: the features that cost most log-odds compared with their
        medians over right poses, the largest cost first."""
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
        """The covariance (6, 6) of a pose, scaled so that the expected errors hold in nine cases of
        ten if the pose is right: off by at most 10 degrees."""
        raw = evidence.raw_rotation_90_deg, evidence.raw_translation_90_deg
        factors = [
            bound_if_right(error) / before if before else 1.0
            for error, before in zip(self.errors_90_deg(evidence), raw, strict=True)
        ]
        scale = np.repeat(factors, 3)
        return covariance * np.outer(scale, scale)

    def errors_90_deg(self, evidence: Evidence) -> tuple[float, float]:
        """The calibrated bounds of the errors of R and t in nine cases of ten, for a pose that may
        be wrong; 0 without a raw error."""
        rotation = evidence.raw_rotation_90_deg or 0.0
        translation = evidence.raw_translation_90_deg or 0.0
        return (
            rotation * self.rotation_error.factor(rotation),
            translation * self.translation_error.factor(translation),
        )


class FittedModels(NamedTuple):
    """The models that `dgc-pose fit-probability` fits."""

    by_kind: Mapping[str, ProbabilityModel]  # by `MatchKind`
    focal_error: ErrorModel  # of ln f of a fitted focal length, per cent
    weights: frozenset[str]  # fingerprints of the networks whose matches were used for the fit

    def model(
        self, weights: str | None, *, key_points: bool, with_map: bool, fitted: bool
    ) -> ProbabilityModel | None:
        """The model for matches, see `match_kind`; None if none is fitted for such matches.
        weights: from `Matches`. The model for key points is for any detector."""
        if not key_points and weights not in self.weights:
            return None
        return self.by_kind.get(match_kind(key_points=key_points, with_map=with_map, fitted=fitted))


@cache
def shipped_models() -> FittedModels:
    """The models in the package."""
    return parse_models(shipped_text())


def shipped_text() -> str:
    """The package's `probability.json`."""
    return files("dgc_pose.estimation").joinpath("probability.json").read_text("utf-8")


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
            tuple(values.get("tested", ())),
        )
        for kind, values in data["models"].items()
    }
    weights = frozenset(e["fingerprint"] for e in data["engine"].values() if e["fingerprint"])
    return FittedModels(models, ErrorModel(**data["focal_error"]), weights)


def calibrated_focal_std(std: float) -> float:
    """The standard deviation of ln f from the raw one, which may be infinite. Raw errors below one
    per cent are scaled like one per cent: few scenes of the fit have them."""
    return std * shipped_models().focal_error.factor(max(100 * NORMAL_90 * std, 1.0))


def bound_if_right(error_90_deg: float) -> float:
    """The bound of a normal error in nine cases of ten if it is at most `RIGHT_DEG`, from the bound
    without this condition."""
    share = 0.9 * _within(error_90_deg)
    return error_90_deg / NORMAL_90 * NormalDist().inv_cdf((1 + share) / 2)


def _logistic(log_odds: float) -> float:
    """The probability of log-odds, which count up to 30 to either side."""
    return 1 / (1 + math.exp(-min(max(log_odds, -30.0), 30.0)))


def _within(error_90_deg: float) -> float:
    """The probability that a normal error is at most `RIGHT_DEG`, from its bound in nine cases of
    ten."""
    return math.erf(NORMAL_90 * RIGHT_DEG / max(error_90_deg, 1e-9) / math.sqrt(2))


def utility(likelihood: float, map_agreement: float | None, weights: Mapping[str, float]) -> float:
    """The log-odds of a hypothesis, up to a constant of the pair."""
    values = {"likelihood": likelihood, "map_agreement": map_agreement or 0.0}
    return sum(weights[name] * values[name] for name in CHOICE_FEATURES if name in weights)


def choice_shares(utilities: Sequence[float] | np.ndarray, lapse: float = 0.0) -> np.ndarray:
    """Probabilities (K,) of the conditional logit model (McFadden 1974) for utilities (K,), -inf
    for an impossible choice. lapse: the probability that all possible choices are equally likely,
    whatever their utilities."""
    values = np.asarray(utilities)
    odds = np.exp(values - values.max())
    possible = np.isfinite(values)
    return (1 - lapse) * odds / odds.sum() + lapse * possible / possible.sum()
