"""The fit of the probability and of the expected error, with scikit-learn.

The probability is a logistic regression. Features whose weight has the wrong sign are dropped, so
that more evidence for a pose never counts against it. Regularisation and calibration (Platt 1999)
use log-odds of each scene from weights fitted on the other scenes. The expected error is a quantile
regression on right poses of scenes whose reference is exact.
"""

from collections.abc import Iterable, Mapping, Sequence
from typing import Any

import numpy as np
from scipy import optimize, special
from sklearn.linear_model import LogisticRegression, QuantileRegressor
from sklearn.model_selection import LeaveOneGroupOut, cross_val_predict

from dgc_pose.benchmarks.evaluate import folded
from dgc_pose.benchmarks.probability.records import Record
from dgc_pose.cameras.lines import LOG_FOCALS, calibrated
from dgc_pose.cameras.prior import auto_camera
from dgc_pose.errors import InputError
from dgc_pose.estimation.evidence import Evidence
from dgc_pose.estimation.probability import (
    CHOICE_FEATURES,
    FEATURES,
    FITTED_FOCAL_FEATURES,
    MAP_FEATURES,
    MATCHER_FEATURES,
    MatchKind,
    choice_shares,
    log_error,
)
from dgc_pose.images.decoding import Header

_STRENGTHS = (0.003, 0.01, 0.03, 0.1, 0.3, 1.0)  # inverse regularisation, standardised features
_MIN_POSES = 20  # least number of right poses, and of wrong ones, for a fit
_MIN_SCENES = 3
_WITHIN = 0.9  # intended share of right poses with an error below the expected one
_QUANTILES = (0.9, 0.91, 0.92, 0.93, 0.94, 0.95, 0.96, 0.97, 0.98)
_MOST_FOCAL_FIT_DEG = 30.0  # focal lengths of poses worse than this are not used
_CERTAIN = 30.0  # log-odds of certainty
_LEAST_SLOPE = 0.2  # of the calibration
_RIDGE = 1e-3  # on the weights of the choice
_LAPSE = 0.05  # start value of the lapse of the choice
_MOST_LAPSE = 0.5  # its upper bound
_SHARPNESSES = (1.0, 2.0, 2.5, 3.0, 3.5, 4.0, 6.0)
_CHANCES = (0.01, 0.02, 0.03, 0.05, 0.1, 0.2)
_NEWTON_STEPS = 100
_LONGEST_STEP = 2.0
_SMALL_STEP = 1e-9
Samples = Sequence[tuple[Record, Evidence]]


def fit_model(rows: Sequence[Record], kind: MatchKind) -> dict[str, Any]:
    """Fit the model for `probability.json` to the records of the part `fit` that have evidence.

    Raises InputError for too few right poses, wrong poses or scenes.
    """
    samples = [sample for sample in _fitted(rows) if sample[0].entry.kind != "pasted"]
    right = np.array([row.any_right for row, _ in samples], bool)
    scenes = np.array([row.scene for row, _ in samples])
    counts = (right.sum(), (~right).sum())
    places = len(np.unique(scenes))
    if min(counts) < _MIN_POSES or places < _MIN_SCENES:
        raise InputError(
            f"{kind}: {counts[0]} right and {counts[1]} wrong poses of {places} scenes to fit on; "
            f"at least {_MIN_POSES} of each and {_MIN_SCENES} scenes are needed"
        )
    left_out = (
        *(() if kind.startswith("network") else MAP_FEATURES),
        *(MATCHER_FEATURES if kind.startswith("key_points") else ()),
        *(() if kind.endswith("auto") else FITTED_FOCAL_FEATURES),
    )
    names = [name for name in FEATURES if name not in left_out]
    X = np.array([[FEATURES[name].value(e) for name in names] for _, e in samples])
    signs = np.array([FEATURES[name].sign for name in names])
    odds = {c: _cross_validated_log_odds(X, right, scenes, signs, c) for c in _STRENGTHS}
    # The one with the smallest negative log-likelihood
    strength = min(odds, key=lambda c: np.logaddexp(0, np.where(right, -odds[c], odds[c])).mean())
    slope, offset = _platt(odds[strength], right)
    weights, intercept = _logistic(X, right, signs, strength)
    medians = np.median(X[right], axis=0)
    used = [column for column, weight in enumerate(weights) if weight != 0]
    accurate = []
    for row, evidence in samples:
        is_measured = row.exact and (row.cameras == "exact" or row.exact_cameras)
        if is_measured and row.best.right:
            accurate.append((row, evidence))
    return {
        "weights": {names[k]: round(slope * weights[k], 6) for k in used},
        "intercept": round(slope * intercept + offset, 6),
        "reference": {names[k]: round(float(medians[k]), 6) for k in used},
        "rotation_error": _error_model(accurate, "rotation"),
        "translation_error": _error_model(accurate, "translation"),
        "choice": fit_choice([row for row, _ in samples], with_map=kind.startswith("network")),
    }


def _fitted(rows: Sequence[Record]) -> list[tuple[Record, Evidence]]:
    """The records of the part `fit` that have evidence, with it."""
    known = [(row, row.evidence) for row in rows if row.entry.part == "fit"]
    return [(row, evidence) for row, evidence in known if evidence is not None]


def fit_choice(rows: Sequence[Record], *, with_map: bool) -> dict[str, float]:
    """Fit the weights of `ProbabilityModel.choice`: maximum likelihood with a small ridge, over the
    records with several poses of which at least one is right.

    Raises InputError without such records.
    """
    names = [name for name in CHOICE_FEATURES if with_map or name != "map_agreement"]
    several = [row.poses for row in rows if row.any_right and len(row.poses) > 1]
    if not several:
        raise InputError("no pair has a right pose among several to fit the choice on")
    features = [np.array([[getattr(p, n) for n in names] for p in poses]) for poses in several]
    right = [np.array([pose.right for pose in poses]) for poses in several]

    def loss(weights: np.ndarray) -> float:
        *slopes, lapse = weights
        chances = [
            choice_shares(values @ slopes, lapse)[true].sum()
            for values, true in zip(features, right, strict=True)
        ]
        return float(_RIDGE * (weights**2).sum() - np.log(np.maximum(chances, 1e-12)).sum())

    start = [*np.ones(len(names)), _LAPSE]
    bounds = [*len(names) * [(0, None)], (0, _MOST_LAPSE)]
    fitted = optimize.minimize(loss, start, bounds=bounds)
    return {name: round(float(w), 6) for name, w in zip([*names, "lapse"], fitted.x, strict=True)}


def fit_focal_error(rows: Sequence[Record]) -> dict[str, float]:
    """Fit the `ErrorModel` of focal lengths to the records of the part `fit` that estimated a focal
    length and whose pose is not far off. With too few records, raw errors stay as they are."""
    samples = []
    for row, evidence in _fitted(rows):
        errors_deg = row.best.rotation_error_deg, folded(row.best.translation_error_deg)
        is_near = all(error_deg < _MOST_FOCAL_FIT_DEG for error_deg in errors_deg)
        is_measured = row.exact and row.exact_cameras and is_near
        if is_measured and evidence.raw_focal_90_percent is not None:
            samples.append((row, evidence))
    if len(samples) < _MIN_POSES:
        return {"slope": 0.0, "intercept": 0.0}
    return _error_model(samples, "focal")


def fit_lines(pieces: Iterable[Mapping[str, Any]]) -> dict[str, float]:
    """Fit `SHARPNESS` and `CHANCE` of `cameras.lines`: they maximise the mean log posterior of the
    true focal lengths of the images of `collect`, given the lines. `gain`: the increase over the
    mean log prior."""
    images = {}
    for piece in pieces:
        for true, scores, count in piece["focals"]:
            key = piece["scene"], round(true, 6), tuple(scores)
            images[key] = (true, np.array(scores), count)
    focal_prior = auto_camera(Header("", (640, 480))).focal_prior
    assert focal_prior is not None
    prior = np.zeros(len(LOG_FOCALS))
    for part in (focal_prior.usual, focal_prior.tail):
        off = (LOG_FOCALS - part.log_focal) / part.std
        prior += np.exp(part.log_weight - off**2 / 2) / part.std

    def gain(sharpness: float, chance: float) -> float:
        gains = []
        for true, scores, count in images.values():
            lines = calibrated(scores, count, sharpness, chance)
            evidence = np.log((np.exp(lines) * prior).sum() / prior.sum())
            gains.append(np.interp(true, LOG_FOCALS, lines) - evidence)
        return float(np.mean(gains)) if gains else 0.0

    best = max(((s, c) for s in _SHARPNESSES for c in _CHANCES), key=lambda both: gain(*both))
    return {"sharpness": best[0], "chance": best[1], "gain": round(gain(*best), 3)}


def fit_same_place(around: np.ndarray, right: np.ndarray) -> dict[str, float]:
    """Fit the `SamePlace` of claimed poses to their `Evidence.context_ratio` (n,) and whether each
    is right (n,) or shows two places. Too few poses give certainty of one place."""
    if min(right.sum(), (~right).sum()) < _MIN_POSES:
        return {"slope": 0.0, "intercept": _CERTAIN}
    fitted = regression(1e6).fit(around[:, None], right)
    slope = float(fitted.coef_[0, 0])
    intercept = float(fitted.intercept_[0])
    return {"slope": round(max(slope, 0.0), 6), "intercept": round(intercept, 6)}


def _logistic(
    X: np.ndarray, right: np.ndarray, signs: np.ndarray, strength: float
) -> tuple[np.ndarray, float]:
    """Weights (F,) of the features, 0 for dropped ones, and the intercept."""
    used = np.arange(X.shape[1])
    while True:
        mean = X[:, used].mean(0)
        deviation = np.maximum(X[:, used].std(0), 1e-6)
        coefficients, intercept = _ridge_fit((X[:, used] - mean) / deviation, right, strength)
        signed = coefficients * signs[used]
        if (signed >= 0).all() or len(used) == 1:
            weights = np.zeros(X.shape[1])
            weights[used] = np.maximum(signed, 0) * signs[used] / deviation
            return weights, intercept - float(weights[used] @ mean)
        used = np.delete(used, int(np.argmin(signed)))


def _ridge_fit(X: np.ndarray, right: np.ndarray, strength: float) -> tuple[np.ndarray, float]:
    """As `regression`, by Newton's method: coefficients (F,) and the intercept. Cross-validation
    makes a thousand such fits; the checks of scikit-learn would take longer than these."""
    columns = np.column_stack([X, np.ones(len(X))])
    penalty = np.append(np.full(X.shape[1], 1 / strength), 0.0)
    weights = np.zeros(len(penalty))
    for _ in range(_NEWTON_STEPS):
        chance = special.expit(columns @ weights)
        slope = columns.T @ (chance - right) + penalty * weights
        curvature = columns.T * (chance * (1 - chance)) @ columns + np.diag(penalty)
        step = np.linalg.solve(curvature, slope)
        weights -= step * min(1.0, _LONGEST_STEP / max(np.abs(step).max(), 1e-12))
        if np.abs(step).max() < _SMALL_STEP:
            break
    return weights[:-1], float(weights[-1])


def _cross_validated_log_odds(
    X: np.ndarray, right: np.ndarray, scenes: np.ndarray, signs: np.ndarray, strength: float
) -> np.ndarray:
    """Log-odds (N,) of each pose, with weights fitted on the other scenes."""
    odds = np.zeros(len(X))
    for scene in np.unique(scenes):
        out = scenes == scene
        weights, intercept = _logistic(X[~out], right[~out], signs, strength)
        odds[out] = X[out] @ weights + intercept
    return odds


def _platt(odds: np.ndarray, right: np.ndarray) -> tuple[float, float]:
    """Slope and offset that calibrate the log-odds of `_cross_validated_log_odds`.

    The targets are smoothed as Platt proposes, so that the slope of separable samples is finite.
    """
    high = (right.sum() + 1) / (right.sum() + 2)
    low = 1 / ((~right).sum() + 2)
    target = np.where(right, high, low)
    X = np.repeat(odds, 2)[:, None]
    y = np.tile([True, False], len(odds))
    weight = np.column_stack([target, 1 - target]).ravel()
    fitted = regression(1e6).fit(X, y, sample_weight=weight)
    return max(float(fitted.coef_[0, 0]), _LEAST_SLOPE), float(fitted.intercept_[0])


def _error_model(samples: Samples, part: str) -> dict[str, float]:
    """Quantile regression of log(error / raw error) on `log_error` of the raw error.

    The quantile is the least that holds for 90 % of the poses in cross-validation over scenes,
    because the errors within a scene are correlated.
    """
    X = list[list[float]]()
    y = list[float]()
    scenes = list[str]()
    for row, evidence in samples:
        if part == "focal":
            raw = evidence.raw_focal_90_percent
            error = row.focal_error_percent
        else:
            raw = getattr(evidence, f"raw_{part}_90_deg")
            error = getattr(row.best, f"{part}_error_deg")
        if raw is not None:
            X.append([log_error(raw)])
            y.append(np.log(max(error, 1e-4) / max(raw, 1e-4)))
            scenes.append(row.scene)
    for quantile in _QUANTILES:
        regressor = QuantileRegressor(quantile=quantile, alpha=0.0, solver="highs")
        left_out = cross_val_predict(regressor, X, y, groups=scenes, cv=LeaveOneGroupOut())
        if np.mean(y <= left_out) >= _WITHIN:
            break
    fitted = regressor.fit(X, y)
    return {"slope": round(float(fitted.coef_[0]), 6), "intercept": round(fitted.intercept_, 6)}


def regression(strength: float) -> Any:
    """Logistic regression. strength: inverse regularisation."""
    return LogisticRegression(C=strength, max_iter=5000)
