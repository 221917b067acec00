"""The probability that a pose is right, and its expected error, from all the evidence.

A logistic model of a few features, fitted by `dgc-pose fit-probability`. `probability.json` holds a
model for each kind of matches; `probability.md` beside it is the card: data, split, figures.
"""

from __future__ import annotations

import json
import math
from collections.abc import Callable, Mapping
from dataclasses import dataclass
from functools import cache
from importlib.resources import files
from typing import Any, Literal

import numpy as np

from dgc_pose.errors import InputError, reason
from dgc_pose.estimation.evidence import Evidence

RIGHT_DEG = 10.0  # a pose is right if R and t are both off by no more
FORMAT = 1  # of the file
MatchKind = Literal["network", "matches", "key_points"]
_SHIPPED = "probability.json"
_MOST_REASONS = 3
_MAX_LOG_FACTOR = 4.0  # of the calibrated error over the jackknife's


def match_kind(evidence: Evidence) -> MatchKind:
    """Which model applies: of matches with a dense map, without one, or of key points."""
    if evidence.key_points:
        return "key_points"
    return "matches" if evidence.map_agreement is None else "network"


@dataclass(frozen=True)
class Feature:
    """A number made of the evidence; the logistic model is linear in it."""

    value: Callable[[Evidence], float]
    sign: int  # of its weight: 1 if more of it speaks for the pose, -1 if against
    words: Callable[[Evidence], str]  # what speaks against a pose that has little, or much, of it


def _log(value: float | None, low: float, high: float) -> float:
    return math.log(min(max(high if value is None else value, low), high))


# Ranges cut off what cannot change the answer any more, so that the model never extrapolates.
FEATURES: Mapping[str, Feature] = {
    "inliers": Feature(
        lambda e: _log(e.num_inliers, 5, 2000), 1, lambda e: f"only {e.num_inliers} inliers"
    ),
    "inlier_ratio": Feature(
        lambda e: e.inlier_ratio,
        1,
        lambda e: f"only {100 * e.inlier_ratio:.0f} % of the matches are inliers",
    ),
    "over_chance": Feature(
        lambda e: _log(e.inlier_ratio / max(e.chance_ratio, 1e-6), 1, 100),
        1,
        lambda e: f"wrong matches have {100 * e.chance_ratio:.0f} % inliers as well",
    ),
    "false_alarms": Feature(
        lambda e: _log(-e.log10_false_alarms, 1, 5000),
        1,
        lambda e: "so many inliers could be chance",
    ),
    "cheirality": Feature(
        lambda e: e.cheirality_ratio,
        1,
        lambda e: f"only {100 * e.cheirality_ratio:.0f} % lie in front of both cameras",
    ),
    "occupied_cells": Feature(
        lambda e: _log(e.occupied_cells, 3, 400),
        1,
        lambda e: f"the inliers lie in only {e.occupied_cells} grid cells",
    ),
    "hull": Feature(
        lambda e: _log(e.hull_cells, 2, 400),
        1,
        lambda e: f"the inliers cover only {e.hull_cells:.0f} grid cells",
    ),
    "rotation_error": Feature(
        lambda e: _log(e.jackknife_rotation_90_deg, 0.02, 60),
        -1,
        lambda e: "the inliers hardly determine the rotation",
    ),
    "translation_error": Feature(
        lambda e: _log(e.jackknife_translation_90_deg, 0.05, 120),
        -1,
        lambda e: "the inliers hardly determine the translation",
    ),
    "residual": Feature(
        lambda e: e.residual,
        -1,
        lambda e: "the inliers do not agree closely",
    ),
    "threshold": Feature(
        lambda e: _log(e.threshold_cells, 0.01, 0.5),
        -1,
        lambda e: "the matches are inaccurate",
    ),
    "parallax": Feature(
        lambda e: _log(e.parallax, 0.7, 40), 1, lambda e: "there is little parallax"
    ),
    "rotation_share": Feature(
        lambda e: min(e.rotation_share, 1.0),
        -1,
        lambda e: "a rotation alone explains most matches",
    ),
    "triangulation": Feature(
        lambda e: _log(e.median_triangulation_angle_deg, 0.2, 30),
        1,
        lambda e: f"small triangulation angles ({e.median_triangulation_angle_deg:.1f} deg)",
    ),
    "homography": Feature(
        lambda e: e.homography_ratio,
        -1,
        lambda e: f"one homography explains {100 * e.homography_ratio:.0f} % of the inliers",
    ),
    "depth_spread": Feature(
        lambda e: min(e.depth_spread, 1.0), 1, lambda e: "the inliers have little depth"
    ),
    "confidence": Feature(lambda e: e.confidence, 1, lambda e: "the matched patches are not alike"),
    "run_agreement": Feature(
        lambda e: e.run_agreement,
        1,
        lambda e: f"only {100 * e.run_agreement:.0f} % of the RANSAC runs found this pose",
    ),
    "rival": Feature(
        lambda e: min(e.rival_ratio, 1.0),
        -1,
        lambda e: f"another pose has {100 * e.rival_ratio:.0f} % as many inliers",
    ),
    "matchability": Feature(
        lambda e: e.map_matchability or 0.0, 1, lambda e: "the dense map is hardly matchable"
    ),
    "map_agreement": Feature(
        lambda e: e.map_agreement or 0.0,
        1,
        lambda e: f"only {100 * (e.map_agreement or 0):.0f} % of the dense map agrees with it",
    ),
    "map_over_chance": Feature(
        lambda e: (e.map_agreement or 0.0) - (e.map_chance or 0.0),
        1,
        lambda e: "the dense map agrees with it no more than by chance",
    ),
}
OF_MAPS = ("matchability", "map_agreement", "map_over_chance")


@dataclass(frozen=True)
class ErrorModel:
    """The error that nine right poses in ten stay below, from the jackknife's: a power of it.

    Small errors of the jackknife are the most optimistic, since errors that neighbouring matches
    have in common do not show in it.
    """

    slope: float
    intercept: float

    def factor(self, error_deg: float | None) -> float:
        """By which the jackknife's error (at nine in ten, degrees; None: unknown) is scaled."""
        total = self.intercept + self.slope * log_error(error_deg)
        return math.exp(min(max(total, -_MAX_LOG_FACTOR), _MAX_LOG_FACTOR))


def log_error(error_deg: float | None) -> float:
    """The logarithm of a jackknife's error, within the range that the model was fitted on."""
    return _log(error_deg, 0.005, 60)


@dataclass(frozen=True)
class ProbabilityModel:
    """A logistic model for one kind of matches."""

    weights: Mapping[str, float]  # log-odds for a unit of each feature
    intercept: float
    reference: Mapping[str, float]  # the median of each feature over right poses
    rotation_error: ErrorModel
    translation_error: ErrorModel

    def probability(self, evidence: Evidence) -> float:
        """That R and t are both within 10 degrees."""
        total = self.intercept + sum(
            weight * FEATURES[name].value(evidence) for name, weight in self.weights.items()
        )
        return 1 / (1 + math.exp(-min(max(total, -30.0), 30.0)))

    def against(self, evidence: Evidence) -> list[str]:
        """What speaks against the pose, most first: features by the log-odds that they cost, beside
        those of a typical right pose."""
        costs = {
            name: weight * (self.reference[name] - FEATURES[name].value(evidence))
            for name, weight in self.weights.items()
        }
        worst = sorted((name for name in costs if costs[name] > 0), key=lambda n: -costs[n])
        return [FEATURES[name].words(evidence) for name in worst[:_MOST_REASONS]]

    def calibrated(self, covariance: np.ndarray, evidence: Evidence) -> np.ndarray:
        """The covariance (6, 6) of a pose scaled so that its error holds nine times in ten."""
        factors = (
            self.rotation_error.factor(evidence.jackknife_rotation_90_deg),
            self.translation_error.factor(evidence.jackknife_translation_90_deg),
        )
        scale = np.repeat(factors, 3)
        scaled: np.ndarray = covariance * np.outer(scale, scale)
        return scaled


@cache
def shipped_models() -> Mapping[str, ProbabilityModel]:
    """The models of the package, by kind of matches."""
    return models_of(files("dgc_pose.estimation").joinpath(_SHIPPED).read_text("utf-8"), _SHIPPED)


def models_of(text: str, name: str) -> Mapping[str, ProbabilityModel]:
    """Models from JSON. Raises InputError, with the name, if it does not hold models."""
    try:
        data = json.loads(text)
        if data["format"] != FORMAT:
            raise ValueError(f"format {data['format']}, not {FORMAT}")
        return {kind: _model(values) for kind, values in data["models"].items()}
    except (ValueError, KeyError, TypeError, AttributeError, RecursionError) as error:
        raise InputError(f"{name}: not a model of the probability ({reason(error)})") from None


def _model(values: Mapping[str, Any]) -> ProbabilityModel:
    weights = _numbers(values["weights"], FEATURES)
    rotation, translation = (
        ErrorModel(_finite(part["slope"]), _finite(part["intercept"]))
        for part in (values["rotation_error"], values["translation_error"])
    )
    reference = _numbers(values["reference"], weights)
    if set(reference) != set(weights):
        raise ValueError("features without a reference")
    return ProbabilityModel(weights, _finite(values["intercept"]), reference, rotation, translation)


def _numbers(values: object, known: Mapping[str, object]) -> dict[str, float]:
    if not isinstance(values, dict) or not set(values) <= set(known):
        raise ValueError("unknown features")
    return {str(name): _finite(value) for name, value in values.items()}


def _finite(value: Any) -> float:
    found = float(value)
    if not math.isfinite(found):
        raise ValueError("weights that are not finite")
    return found
