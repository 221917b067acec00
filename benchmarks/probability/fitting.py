"""The fit of the probability and of the expected error, by scikit-learn.

Logistic regression on one part of the scenes; its regularisation by leaving scenes out; features
whose weight has the wrong sign are dropped, so that more evidence for a pose never counts against
it. Log-odds are calibrated on other scenes (Platt 1999). The expected error is a linear quantile
regression on the right poses of both parts.
"""

from __future__ import annotations

import importlib
import json
from collections.abc import Mapping, Sequence
from typing import Any

import numpy as np

from dgc_pose.benchmarks.probability.records import Record
from dgc_pose.errors import InputError
from dgc_pose.estimation.evidence import Evidence
from dgc_pose.estimation.probability import (
    ERROR_FEATURES,
    FEATURES,
    FORMAT,
    OF_MAPS,
    MatchKind,
    error_features,
)

_STRENGTHS = (0.003, 0.01, 0.03, 0.1, 0.3, 1.0)  # inverse regularisation, of standardised features
_LEAST = 20  # right poses and wrong ones that a fit needs, in each part
_QUANTILE = 0.9
_LEAST_SLOPE = 0.2  # of the calibrated log-odds
Samples = Sequence[tuple[Record, Evidence]]


def fit_model(found: Sequence[Record], kind: MatchKind) -> dict[str, Any]:
    """The model, as `probability.json` holds it, of the records that have evidence.

    Raises InputError if scikit-learn is missing or there are too few right or wrong poses.
    """
    samples = [(one, one.evidence) for one in found if one.evidence is not None]
    fit = [pair for pair in samples if pair[0].part == "fit"]
    calibrate = [pair for pair in samples if pair[0].part == "calibrate"]
    for part, own in (("fit", fit), ("calibrate", calibrate)):
        right = sum(one.right for one, _ in own)
        if min(right, len(own) - right) < _LEAST:
            raise InputError(
                f"{kind}: {right} right and {len(own) - right} wrong poses to {part} on; "
                f"at least {_LEAST} of each are needed"
            )
    names = [name for name in FEATURES if kind == "network" or name not in OF_MAPS]
    weights, intercept = _logistic(fit, names)
    slope, offset = _platt(calibrate, weights, intercept)
    rights = [evidence for one, evidence in fit + calibrate if one.right]
    return {
        "weights": {name: round(slope * w, 6) for name, w in weights.items()},
        "intercept": round(slope * intercept + offset, 6),
        "reference": {
            name: round(float(np.median([FEATURES[name].value(e) for e in rights])), 6)
            for name in weights
        },
        **{
            f"{part}_error": _error_model([p for p in fit + calibrate if p[0].right], part)
            for part in ("rotation", "translation")
        },
    }


def models_text(models: Mapping[MatchKind, Mapping[str, Any]], engine: Mapping[str, Any]) -> str:
    """The file that the package reads."""
    return json.dumps({"format": FORMAT, "engine": engine, "models": models}, indent=1) + "\n"


def _logistic(samples: Samples, names: list[str]) -> tuple[dict[str, float], float]:
    """Weights of the features and intercept."""
    right = np.array([one.right for one, _ in samples])
    scenes = np.array([one.scene for one, _ in samples])
    strength = _strength(samples, names, right, scenes)
    while True:
        X = _table(samples, names)
        mean, deviation = X.mean(0), np.maximum(X.std(0), 1e-6)
        fitted = _regression(strength).fit((X - mean) / deviation, right)
        own = fitted.coef_[0]
        signed = own * [FEATURES[name].sign for name in names]
        if (signed >= 0).all():
            weights = own / deviation
            return (
                dict(zip(names, weights.tolist(), strict=True)),
                float(fitted.intercept_[0] - weights @ mean),
            )
        names = [name for k, name in enumerate(names) if k != int(np.argmin(signed))]


def _strength(samples: Samples, names: list[str], right: np.ndarray, scenes: np.ndarray) -> float:
    """The regularisation of least loss on scenes left out."""
    X = _table(samples, names)
    X = (X - X.mean(0)) / np.maximum(X.std(0), 1e-6)
    losses = []
    for strength in _STRENGTHS:
        loss = 0.0
        for scene in np.unique(scenes):
            out = scenes == scene
            if len(np.unique(right[~out])) < 2:
                continue
            chance = _regression(strength).fit(X[~out], right[~out]).predict_proba(X[out])[:, 1]
            chance = chance.clip(1e-4, 1 - 1e-4)
            loss -= float(np.log(np.where(right[out], chance, 1 - chance)).sum())
        losses.append(loss)
    return _STRENGTHS[int(np.argmin(losses))]


def _platt(samples: Samples, weights: Mapping[str, float], intercept: float) -> tuple[float, float]:
    """Slope and offset of the log-odds on scenes that the weights were not fitted on.

    The targets are smoothed as Platt proposes, so that separable samples give no infinite slope.
    """
    names = list(weights)
    odds = _table(samples, names) @ np.array([weights[name] for name in names]) + intercept
    right = np.array([one.right for one, _ in samples])
    high = (right.sum() + 1) / (right.sum() + 2)
    low = 1 / ((~right).sum() + 2)
    target = np.where(right, high, low)
    X, y = np.repeat(odds, 2)[:, None], np.tile([True, False], len(odds))
    weight = np.column_stack([target, 1 - target]).ravel()
    fitted = _regression(1e6).fit(X, y, sample_weight=weight)
    return max(float(fitted.coef_[0, 0]), _LEAST_SLOPE), float(fitted.intercept_[0])


def _error_model(samples: Samples, part: str) -> dict[str, Any]:
    """Quantile regression of log (error / jackknife's)."""
    usable = [
        (one, evidence)
        for one, evidence in samples
        if getattr(evidence, f"{part}_error_90_deg") is not None
    ]
    names = ["own", *ERROR_FEATURES]
    values = [error_features(evidence, part) for _, evidence in usable]
    X = np.array([[row[name] for name in names] for row in values])
    error = np.array([max(getattr(one, f"{part}_error_deg"), 1e-4) for one, _ in usable])
    expected = np.array([getattr(e, f"{part}_error_90_deg") for _, e in usable]).clip(1e-4)
    mean, deviation = X.mean(0), np.maximum(X.std(0), 1e-6)
    regressor = _sklearn("linear_model").QuantileRegressor(
        quantile=_QUANTILE, alpha=0.01, solver="highs"
    )
    fitted = regressor.fit((X - mean) / deviation, np.log(error / expected))
    weights = fitted.coef_ / deviation
    return {
        "weights": {k: round(v, 6) for k, v in zip(names, weights.tolist(), strict=True)},
        "intercept": round(float(fitted.intercept_ - weights @ mean), 6),
    }


def _table(samples: Samples, names: Sequence[str]) -> np.ndarray:
    return np.array([[FEATURES[name].value(e) for name in names] for _, e in samples])


def _regression(strength: float) -> Any:
    return _sklearn("linear_model").LogisticRegression(C=strength, max_iter=5000)


def _sklearn(name: str) -> Any:
    try:
        return importlib.import_module(f"sklearn.{name}")
    except ImportError:
        raise InputError("the fit needs scikit-learn: pip install 'dgc-pose[fit]'") from None
