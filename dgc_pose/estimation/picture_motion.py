"""The motion of a fixed camera between two pictures, by least squares on their matches.

A match maps the pixel u1 to u2 = zoomed lens of project(R x1) + rho g(t). x1 is the direction of
u1, R the rotation, t the shift in median depths, g(t) its parallax, and rho, about 1, the inverse
depth. The zoom is a scale about the principal point. Across the parallax the error of a match is
noise; along it, the unknown rho adds to the noise. The parameters minimise a Cauchy loss of both
errors. People and objects are outliers. All cells of the picture have the same weight: textured
objects do not outvote walls.

What the camera leaves open (focal length, principal point, lens) is fitted too, with the camera's
standard deviations as the prior. A shift that looks like a rotation (of a lens that is not known)
or like a zoom differs from it by the depths alone. So a fit without a shift comes first; one with a
shift replaces it if the matches show parallax.
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from functools import cached_property

import cv2
import numpy as np

from dgc_pose.cameras.camera import Camera
from dgc_pose.estimation.intrinsics_prior import parameter_stds, with_parameters
from dgc_pose.estimation.least_squares import (
    CORRELATED,
    EFFICIENT,
    KEPT,
    Slopes,
    block_jackknife,
    cauchy_losses,
    cauchy_slopes,
    loss_terms,
    minimised,
)
from dgc_pose.geometry.epipolar import homogeneous

NUMBER = 7  # of parameters: a rotation vector, radians; t; ln of the zoom; then those of the camera
TURN = slice(0, 3)
SHIFT = slice(3, 6)
FORWARD = 5  # along the optical axis
ZOOM = 6
_NOTHING = slice(0, 0)
_DEPTH_STD = 0.5  # standard deviation of rho
_SHIFT_STD = 0.1  # of the prior of t
_ZOOM_STD = 0.1  # of the prior of the zoom
_NOISE = 0.16, 0.5  # bounds of the standard deviation of a match, over its expected error
# Largest errors, in standard deviations
_INLIER = 3.6
_OUTLIER = 8.0
_OUTLIER_LOSS = 4.0  # largest loss of a match: an outlier determines no motion
FAR_MORE = 1.5  # times the part of the picture that agrees
_STEPS = 20
_CONVERGED = 5e-5  # of the loss, relative
_STD_INFORMATION = 100.0  # of ln of the standard deviation of a match, for the end of the steps
_MOST_Z = 4.0  # standard deviations by which a camera may deviate
_SLOPE_STEP = 1e-4
# Spreads of the depths over `_DEPTH_STD`: the loss is that of the likeliest.
_SPREADS = 0.2, 0.35, 0.6, 1.0
# Chosen on simulated pairs of other scenes than those of the documentation: a factor on all errors;
# by how much a fit with a shift, and one with a shift and a zoom, must lower the loss; the number
# of matches whose parallax a shift cannot hide; the deviation of ln |t| by the parallax seen.
_ERROR_SCALE = 1.15
_COST_OF_SHIFT = 6.0
_COST_OF_BOTH = 14.0
_HIDDEN = 5.0
_SPREAD_STD = 0.6


@dataclass(frozen=True, eq=False)
class FixedMatches:
    """N matches between two pictures of a camera."""

    points1: np.ndarray  # (N, 2), pixels
    points2: np.ndarray  # (N, 2), pixels
    weights: np.ndarray  # (N,), with sum 1 in each cell of the picture
    error_px: float  # expected error of a match
    camera: Camera  # of both pictures


@dataclass(frozen=True, eq=False)
class Motion:
    """A motion, and how far the camera is from the stated one."""

    R: np.ndarray  # (3, 3)
    t: np.ndarray  # (3,), in median depths
    log_zoom: float  # ln of the scale
    z: np.ndarray  # (M,) deviations of the camera, in standard deviations

    def moved(self, step: np.ndarray) -> Motion:
        """The motion after a step (P,)."""
        R = cv2.Rodrigues(step[TURN])[0] @ self.R
        z = (self.z + step[NUMBER:]).clip(-_MOST_Z, _MOST_Z)
        return Motion(R, self.t + step[SHIFT], self.log_zoom + float(step[ZOOM]), z)


@dataclass(frozen=True, eq=False)
class Minimum:
    """A motion of least loss, and its values at N matches."""

    motion: Motion
    std: float  # standard deviation of a match, pixels
    agree: np.ndarray  # (N,), weights of the matches that agree, 0 for all others
    loss: float  # minus the log-likelihood of the matches, up to a constant


@dataclass(frozen=True, eq=False)
class MotionFit(Minimum):
    """The best of several minima."""

    covariance: np.ndarray  # (P, P) of the parameters
    gain: float  # by how much the shift lowers the loss; 0 for a motion without a shift
    widest: Minimum  # the one that most of the picture agrees with


def at_rest(camera: Camera, R: np.ndarray | None = None) -> Motion:
    """No motion; or a rotation."""
    z = np.zeros(np.count_nonzero(parameter_stds(camera)))
    return Motion(np.eye(3) if R is None else R, np.zeros(3), 0.0, z)


def fitted(matched: FixedMatches, starts: list[tuple[Motion, float]]) -> MotionFit:
    """The motion of least loss, with its covariance: by a rotation and a zoom, or with a shift, or
    with all, if this lowers the loss enough. starts: motions, each with the first standard
    deviation of a match, pixels: the loss has several minima."""
    unshifted = [_minimum(matched, *start, SHIFT, 0.0) for start in starts]
    shifted = [_minimum(matched, *start, ZOOM, _COST_OF_SHIFT) for start in starts]
    both = [_minimum(matched, *start, _NOTHING, _COST_OF_BOTH) for start in starts]
    minima = [*unshifted, *shifted, *both]
    best = minima[0]
    for other in minima[1:]:
        if _is_better(other, best):
            best = other
    return MotionFit(
        best.motion,
        best.std,
        best.agree,
        best.loss,
        covariance=_covariance(matched, best),
        gain=min(minimum.loss for minimum in unshifted) - best.loss,
        widest=max(minima, key=lambda minimum: minimum.agree.sum()),
    )


def _is_better(other: Minimum, best: Minimum) -> bool:
    """Whether a minimum agrees with far more of the picture than another, or has the lower loss and
    does not agree with far less."""
    share = other.agree.sum()
    best_share = best.agree.sum()
    if share > FAR_MORE * best_share:
        return True
    return other.loss < best.loss and best_share <= FAR_MORE * share


def _minimum(
    matched: FixedMatches, motion: Motion, std: float, fixed: slice | int, cost: float
) -> Minimum:
    """The motion of least loss near another. std: first standard deviation of a match, pixels; each
    step reduces it, down to that of the best quarter of the picture. fixed: parameters that stay.
    cost: of the others, added to the loss."""
    free = np.ones(NUMBER + len(motion.z), bool)
    free[fixed] = False
    start = _Trial(matched, motion, max(std, _NOISE[1] * matched.error_px))
    trial = minimised(_MotionProblem(free), start, _STEPS, descends=False, converged=_CONVERGED)
    errors, _, stds = trial.errors
    inliers = (np.abs(errors) < _INLIER).all(1)
    loss = min(_loss(matched, errors, stds, share) for share in _SPREADS)
    return Minimum(trial.motion, trial.std, matched.weights * inliers, cost + loss)


@dataclass(frozen=True, eq=False)
class _Trial:
    """A motion, with the standard deviation of a match, pixels."""

    matched: FixedMatches
    motion: Motion
    std: float

    @cached_property
    def errors(self) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
        """See `_errors`."""
        return _errors(self.matched, self.motion, self.std)

    @cached_property
    def next_std(self) -> float:
        """The standard deviation after a step: that of the best quarter of the picture."""
        across = np.abs(self.errors[0][:, 1])
        shown = self.std * quantile(across, self.matched.weights, 0.25) / 0.3186  # Gaussian
        least, most = np.multiply(_NOISE, self.matched.error_px)
        return max(0.7 * self.std, least, min(shown, most))


@dataclass(frozen=True, eq=False)
class _MotionProblem:
    """Least squares of a motion. The last parameter of a step is ln of the standard deviation of a
    match. free: (P,) bool, the parameters of the motion that do not stay."""

    free: np.ndarray

    def linearised(self, trial: _Trial) -> Slopes:
        errors, slopes, _ = trial.errors
        near = (np.abs(errors) < _OUTLIER).all(1)
        counts = np.repeat(CORRELATED * trial.matched.weights * near, 2)
        matches = cauchy_slopes(errors.ravel(), slopes.reshape(errors.size, -1), EFFICIENT, counts)
        motion = trial.motion
        values = np.array([0, 0, 0, *motion.t, motion.log_zoom, *motion.z])
        cost, hessian, gradient = matches.with_prior(values, _prior(len(motion.z)))
        number = int(self.free.sum())
        beside = np.zeros((number + 1, number + 1))
        beside[:number, :number] = hessian[np.ix_(self.free, self.free)]
        beside[number, number] = _STD_INFORMATION
        change = _STD_INFORMATION * math.log(trial.std / trial.next_std)
        return Slopes(cost, beside, np.append(gradient[self.free], change))

    def moved(self, trial: _Trial, step: np.ndarray) -> _Trial:
        whole = np.zeros(len(self.free))
        whole[self.free] = step[:-1]
        std = trial.std * math.exp(step[-1])
        return _Trial(trial.matched, trial.motion.moved(whole), std)


def _loss(matched: FixedMatches, errors: np.ndarray, stds: np.ndarray, share: float) -> float:
    """The loss of a motion. errors, stds: from `_errors`. share: of the assumed spread of the
    depths."""
    noise = stds[:, 1]
    spread = np.sqrt(np.maximum(stds[:, 0] ** 2 - noise**2, 0))
    along = np.hypot(noise, share * spread)
    scaled = errors * np.column_stack([stds[:, 0] / along, np.ones_like(along)])
    losses = CORRELATED * cauchy_losses(scaled, EFFICIENT).sum(1)
    losses += np.log(along * noise / matched.error_px**2)
    return float(matched.weights @ np.minimum(losses, _OUTLIER_LOSS))


def _prior(count: int) -> np.ndarray:
    """The information (P,) of the parameters before the matches, with `count` of the camera."""
    shift = [1 / _SHIFT_STD**2] * 3
    return np.array([1e-6] * 3 + shift + [1 / _ZOOM_STD**2] + [1.0] * count)


def _covariance(matched: FixedMatches, fit: Minimum) -> np.ndarray:
    """The covariance (P, P) of all parameters, also of those that the fit leaves at 0."""
    errors, slopes, _ = _errors(matched, fit.motion, fit.std)
    inliers = (fit.agree > 0) if fit.agree.any() else np.ones(len(errors), bool)
    size = slopes.shape[2]
    terms = loss_terms(errors.ravel(), slopes.reshape(-1, size), EFFICIENT)
    terms *= np.repeat(matched.weights, 2)[:, None]
    some = np.repeat(inliers, 2)
    terms = terms[some]
    points = np.repeat(matched.points1, 2, axis=0)[some]
    information = terms[:, : size**2].sum(0).reshape(size, size) + np.diag(_prior(size - NUMBER))
    # The spread of the parallax determines t, too.
    by_shift = pictured(matched.points1[inliers], matched.camera, fit.motion)[1][..., SHIFT]
    weights = matched.weights[inliers]
    squares = np.einsum("n,nki,nkj->ij", weights / weights.sum(), by_shift, by_shift)
    t = fit.motion.t
    if t.any():
        along = squares @ t / (t @ squares @ t)
        information[SHIFT, SHIFT] += np.outer(along, along) / _SPREAD_STD**2
    else:
        information[SHIFT, SHIFT] += _HIDDEN * (_DEPTH_STD / fit.std) ** 2 * squares
    blocks = block_jackknife(information, terms, points, KEPT)
    covariance: np.ndarray = _ERROR_SCALE**2 * (blocks + np.linalg.inv(information))
    return covariance


def _errors(
    matched: FixedMatches, motion: Motion, std: float
) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """The errors (N, 2) of matches, along and across the parallax, over their standard deviations;
    their derivatives (N, 2, P); and the standard deviations (N, 2), pixels."""
    seen, slopes = pictured(matched.points1, matched.camera, motion)
    parallax = slopes[..., SHIFT] @ motion.t
    direction = parallax + (1e-9, 0.0)  # any direction if there is no parallax
    length = np.linalg.norm(direction, axis=1, keepdims=True)
    along = direction / length
    spread = _DEPTH_STD * length
    axes = np.stack([along, along[:, ::-1] * (-1, 1)], 1)
    stds = np.hstack([np.hypot(std, spread), np.full_like(spread, std)])
    errors = np.einsum("nki,ni->nk", axes, matched.points2 - seen - parallax) / stds
    slopes = axes @ slopes / -stds[..., None]
    rho = 1 + _DEPTH_STD * spread[:, 0] * errors[:, 0] / stds[:, 0]
    slopes[:, 1, SHIFT] *= rho.clip(0, 4)[:, None]
    # Where the lens has no inverse, a match is an outlier.
    known = np.isfinite(errors).all(1) & np.isfinite(slopes).all((1, 2))
    errors[~known] = 1e6
    slopes[~known] = 0.0
    return errors, slopes, np.nan_to_num(stds, nan=std)


def pictured(points1: np.ndarray, camera: Camera, motion: Motion) -> tuple[np.ndarray, np.ndarray]:
    """Where pixels (N, 2) of picture 1 are seen in picture 2 without parallax, pixels (N, 2); and
    the derivatives (N, 2, P) by the parameters, those by t at the median depth."""
    changed = _changed(camera, motion.z)
    turned = _turned(changed.normalise(points1), motion.R)
    seen = _zoomed(changed, turned, motion)
    x, y = turned.T
    along_x = np.stack([-x * y, 1 + x * x, -y, 1 + 0 * x, 0 * x, -x], -1)
    along_y = np.stack([-1 - y * y, x * y, x, 0 * y, 1 + 0 * y, -y], -1)
    ahead = [_zoomed(changed, turned + axis, motion) - seen for axis in _SLOPE_STEP * np.eye(2)]
    by_turned = np.stack(ahead, axis=2) / _SLOPE_STEP
    slopes = np.zeros((len(points1), 2, NUMBER + len(motion.z)))
    slopes[..., :ZOOM] = by_turned @ np.stack([along_x, along_y], 1)
    slopes[..., ZOOM] = seen - changed.K[:2, 2]
    for number, axis in enumerate(_SLOPE_STEP * np.eye(len(motion.z))):
        other = _changed(camera, motion.z + axis)
        moved = _zoomed(other, _turned(other.normalise(points1), motion.R), motion)
        slopes[..., NUMBER + number] = (moved - seen) / _SLOPE_STEP
    return seen, slopes


def how_far_px(motion: Motion, points: np.ndarray, camera: Camera) -> tuple[np.ndarray, np.ndarray]:
    """How far points of the picture (N, 2) move at the median depth, pixels (N,); and the
    derivatives of `pictured`."""
    seen, slopes = pictured(points, camera, motion)
    moves = np.linalg.norm(seen + slopes[..., SHIFT] @ motion.t - points, axis=1)
    return np.nan_to_num(moves), slopes


def _changed(camera: Camera, z: np.ndarray) -> Camera:
    """The camera with deviations (M,)."""
    stds = np.array(parameter_stds(camera))
    parameters = np.zeros(len(stds))
    parameters[stds > 0] = stds[stds > 0] * z
    return with_parameters(camera, parameters)


def _zoomed(camera: Camera, normalised: np.ndarray, motion: Motion) -> np.ndarray:
    """Where normalised points (N, 2) are seen after the zoom of a motion, pixels (N, 2)."""
    centre = camera.K[:2, 2]
    return centre + math.exp(motion.log_zoom) * (camera.project(normalised) - centre)


def _turned(normalised: np.ndarray, R: np.ndarray) -> np.ndarray:
    rays = homogeneous(normalised) @ R.T
    with np.errstate(divide="ignore", invalid="ignore"):
        return np.where(rays[:, 2:] > 0, rays[:, :2] / rays[:, 2:], np.nan)


def quantile(values: np.ndarray, weights: np.ndarray, share: float) -> float:
    """The weighted quantile of values (N,) at a share of all weights (N,)."""
    order = np.argsort(values)
    total = np.cumsum(weights[order])
    return float(values[order][np.searchsorted(total, share * total[-1])])
