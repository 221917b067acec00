"""Whether a fixed camera has moved between two pictures, and by how much.

A match at the normalised point x1, of inverse depth rho over its median, is at x2 = project(R x1 +
rho t). The parallax rho g(t) is small, so a match has two errors: across the parallax, of the noise
alone, and along it, of the noise and of the unknown rho, which is 1 on average. R and t minimise a
Cauchy loss of both. t may vanish: a pure rotation is no special case.

Each cell of the picture has the same weight, so that a textured object does not outvote a plain
wall. People and other objects are outliers, or the picture shows a part that stays and a part that
moves: then the camera has not moved.
"""

from __future__ import annotations

import math
import time
from collections.abc import Mapping
from dataclasses import asdict, dataclass, field, replace
from pathlib import Path
from typing import TYPE_CHECKING, Any, Literal, NamedTuple

import cv2
import numpy as np

from dgc_pose.cameras.calibration import pair_cameras
from dgc_pose.cameras.camera import Camera
from dgc_pose.errors import ArgumentName, InputError
from dgc_pose.estimation.covariance import NORMAL_90
from dgc_pose.estimation.least_squares import (
    EFFICIENT,
    KEPT,
    SHIFTS,
    block_sums,
    jackknife,
    loss_terms,
)
from dgc_pose.geometry.epipolar import homogeneous
from dgc_pose.geometry.rotation import aligning_rotation, rotation_angle_deg
from dgc_pose.geometry.triangulation import unit_rays
from dgc_pose.images.image import load_image
from dgc_pose.matchers import load_matcher
from dgc_pose.matches import Matches
from dgc_pose.matching import DEFAULT_WEIGHTS, Matcher
from dgc_pose.system.options import check_type
from dgc_pose.system.threads import one_blas_thread

if TYPE_CHECKING:
    from dgc_pose.pose import CameraSource, ImageSource, MatcherSource

Verdict = Literal["still", "moved", "cannot say"]
STILL_DEG = 0.05  # a smaller apparent motion is none
_LEAST_DEG, _SIGNIFICANT = 0.01, 1.5  # apparent motion of a moved camera: above, and in errors
_WITHIN = 0.9  # share of the picture whose apparent motion is below that of the verdict
_CELLS = 16  # along the longer side of the picture
_MIN_MATCHES, _COVERED = 50, 0.1  # the latter is the share of the picture's cells that agree
# Shares of the matched cells: that agree on one motion; that stay, beyond those that the motion
# leaves in place, while objects move; and that stay at the most if the camera has moved for sure.
_AGREE, _STAYS, _NOTHING_STAYS = 0.4, 0.2, 0.05
_DEPTH_STD = 0.5  # of the inverse depth over its median
_DEPTHS_ALIKE = 2.0  # times that, in weight: neighbours have similar depths
_SHIFT_STD = 0.1  # prior of t, in median depths
_NOISE = 0.16, 0.5  # least and largest standard deviation of a match, in its expected error
_ERROR_SCALE = 1.3  # of the covariance's root: chosen on simulated pairs, docs/experiments.md
_INLIER = 3.6  # standard deviations
_OBJECT = 0.02  # typical motion of an object, normalised
_START_MATCHES, _START_STEPS, _STEPS, _SAMPLES = 500, 15, 40, 200


@dataclass(frozen=True)
class CameraMotion:
    """The motion of a camera from a reference picture to the picture now.

    Attributes:
        verdict: "still": the picture moves by less than 0.05 degrees. "moved": it moves
            significantly. "cannot say": `reason` has why.
        reason: One sentence for people.
        angle_deg: Angle of the rotation, degrees; None without enough matches.
        angle_error_90_deg: Error of the angle that nine in ten stay below, degrees.
        shift: Distance between the camera centres, in median depths of the matched scene.
        shift_error_90: Error of the shift that nine in ten stay below, in median depths.
        num_matches: Number of matches.
        num_inliers: Number of matches that agree with the motion.
        warnings: Sentences about what makes the result uncertain, for people.
        seconds: Time by what was done: "load", "match", "estimate".
    """

    verdict: Verdict
    reason: str
    angle_deg: float | None = None
    angle_error_90_deg: float | None = None
    shift: float | None = None
    shift_error_90: float | None = None
    num_matches: int = 0
    num_inliers: int = 0
    warnings: tuple[str, ...] = ()
    seconds: Mapping[str, float] = field(default_factory=dict)

    def to_dict(self) -> dict[str, Any]:
        """The values for JSON."""
        return asdict(self)


class _Fit(NamedTuple):
    """A motion with the errors of N matches, over their standard deviations."""

    R: np.ndarray  # (3, 3)
    t: np.ndarray  # (3,), in median depths
    std: float  # of a match, normalised
    errors: np.ndarray  # (N, 2), along and across the parallax
    slopes: np.ndarray  # (N, 2, 6), their derivatives by a rotation vector, radians, and t
    weights: np.ndarray  # (N, 2)
    score: float  # mean log likelihood

    @property
    def inliers(self) -> np.ndarray:
        """(N,) bool."""
        inliers: np.ndarray = (np.abs(self.errors) < _INLIER).all(1)
        return inliers


def camera_motion(
    reference: ImageSource,
    now: ImageSource,
    K: CameraSource = None,
    *,
    matcher: MatcherSource = None,
) -> CameraMotion:
    """Whether a fixed camera has moved since the reference picture, and by which angle and shift.

    reference, now: paths, arrays (H, W[, 3]) in RGB order, or tensors, of one size. K: as of
    `estimate_relative_pose`; without it, the uncertainty of the focal length enters the errors.
    matcher: by default `load_matcher()`.

    Raises ImageError if an image cannot be read, InputError (a ValueError) if another argument is
    unusable or the sizes differ, WeightsError if the network's weights cannot be loaded.

    >>> camera_motion("installed.jpg", "today.jpg", K).verdict  # doctest: +SKIP
    """
    start = time.perf_counter()
    first, second = load_image(reference, "reference"), load_image(now, "now")
    if first.size != second.size:
        sizes = ("{} x {}".format(*image.size) for image in (second, first))
        raise InputError(ArgumentName("now"), "has {} pixels, and reference {}".format(*sizes))
    check_type(matcher, Matcher | str | Path | None, "matcher")
    camera = pair_cameras(K, K, first, first, ("K", "K"))[0]
    matcher = DEFAULT_WEIGHTS if matcher is None else matcher
    matcher = load_matcher(matcher) if isinstance(matcher, str | Path) else matcher
    loaded = time.perf_counter()
    matches = matcher.match(first, second).matches
    matched = time.perf_counter()
    motion = motion_of_matches(matches, camera, first.size)
    estimated = time.perf_counter()
    seconds = {"load": loaded - start, "match": matched - loaded, "estimate": estimated - matched}
    return replace(motion, warnings=camera.warnings, seconds=seconds)


@one_blas_thread()
def motion_of_matches(matches: Matches, camera: Camera, size: tuple[int, int]) -> CameraMotion:
    """The motion of a camera by its matches. size: (width, height) of both pictures."""
    cell = max(size) / _CELLS
    points = [camera.normalise(points) for points in (matches.points1, matches.points2)]
    usable = np.isfinite(np.hstack(points)).all(1)
    x1, x2 = (values[usable] for values in points)
    if len(x1) < _MIN_MATCHES:
        return CameraMotion("cannot say", f"only {len(x1)} matches", num_matches=len(x1))
    column, row = (matches.points1[usable] // cell).astype(int).T
    _, in_cell, count = np.unique(column * 9999 + row, return_inverse=True, return_counts=True)
    weights = 1 / count[in_cell]

    pixel = matches.error_px / camera.focal
    fit = _best_fit(x1, x2, weights, pixel)
    covariance = _covariance(fit, x2)
    motion, error = _apparent_motion_deg(fit, covariance, x1)

    def share(of: np.ndarray) -> float:
        return float(weights @ of) / len(count)

    def within(values: np.ndarray) -> float:
        """What the values stay below in most of the picture that agrees with the motion."""
        order = np.argsort(values)
        total = np.cumsum((weights * fit.inliers)[order])
        return float(values[order][np.searchsorted(total, _WITHIN * total[-1])])

    stay = np.linalg.norm(x2 - x1, axis=1) < 3 * fit.std
    moved = within(motion - _SIGNIFICANT * error) > _LEAST_DEG
    moved |= within(motion) > STILL_DEG and share(stay) < _NOTHING_STAYS
    if share(stay - _left_in_place(fit, x1)) > _STAYS if moved else share(stay) > _AGREE:
        moved = False  # all else is people and objects
        fit = _fit(x1, x2, weights * stay, pixel, np.eye(3), np.zeros(3), 0.0, _STEPS)
        covariance = _covariance(fit, x2)
        motion, error = _apparent_motion_deg(fit, covariance, x1)
    agree = share(fit.inliers)
    verdict: Verdict = "cannot say"
    if agree < (_AGREE if moved else _STAYS):
        reason = f"only {100 * agree:.0f} % of the matched picture agrees on one motion"
    elif agree * len(count) < _COVERED * size[0] * size[1] / cell**2:
        reason = "the matches that agree cover too little of the picture"
    elif moved:
        verdict = "moved"
        reason = f"{100 * agree:.0f} % of the matched picture moves by {within(motion):.3g} deg"
    elif (most := within(motion + error)) < STILL_DEG:
        verdict, reason = "still", f"the picture moves by less than {max(most, 0.001):.3f} deg"
    else:
        reason = f"the picture moves by {within(motion):.3f} +- {within(error):.3f} deg"
    angle, shift = rotation_angle_deg(fit.R), float(np.linalg.norm(fit.t))
    errors = NORMAL_90 * np.sqrt([covariance[:3, :3].trace(), covariance[3:, 3:].trace()])
    by_focal = NORMAL_90 * camera.focal_std
    return CameraMotion(
        verdict,
        reason,
        angle,
        math.hypot(math.degrees(errors[0]), by_focal * angle),
        shift,
        math.hypot(errors[1], by_focal * shift),
        len(x1),
        int(fit.inliers.sum()),
    )


def _best_fit(x1: np.ndarray, x2: np.ndarray, weights: np.ndarray, pixel: float) -> _Fit:
    """The likeliest motion. pixel: expected error of a match, normalised.

    The loss has several minima: the fit starts from no motion, from the rotation that most of the
    picture agrees with, and from that with shifts along each axis.
    """
    rng = np.random.default_rng(0)
    R, none = _common_rotation(x1, x2, weights, rng), np.zeros(3)
    apart = np.linalg.norm(_errors(x1, x2, R, none)[0], axis=1)
    shift = max(float(np.median(apart)), pixel) * np.diag([1.0, 1, 2])
    still = np.eye(3)
    wide, narrow = 8 * pixel, 2 * pixel
    starts = [(still, none, 0.0), (still, none, wide), (R, none, wide)]
    starts += [(R, sign * t, narrow) for t in shift for sign in (1, -1)]
    some = rng.permutation(len(x1))[:_START_MATCHES]
    part = x1[some], x2[some], weights[some] * weights.sum() / weights[some].sum(), pixel
    tried = [_fit(*part, *start, _START_STEPS) for start in starts]
    best = max(tried, key=lambda fit: fit.score)
    return _fit(x1, x2, weights, pixel, best.R, best.t, 0.0, _STEPS)


def _common_rotation(
    x1: np.ndarray, x2: np.ndarray, weights: np.ndarray, rng: np.random.Generator
) -> np.ndarray:
    """The rotation (3, 3) that most of the picture agrees with, of those of random pairs."""
    rays1, rays2 = unit_rays(x1), unit_rays(x2)
    pairs = rng.choice(len(x1), (_SAMPLES, 2), p=weights / weights.sum())
    rotations = [aligning_rotation(rays1[pair], rays2[pair]) for pair in pairs]

    def agreement(R: np.ndarray) -> float:
        squared = np.square(rays1 @ R.T - rays2).sum(1)
        return float(weights @ (1 / (1 + squared / _OBJECT**2)))

    return max(rotations, key=agreement)


def _slopes(points: np.ndarray) -> np.ndarray:
    """The derivatives (N, 2, 6) of normalised points (N, 2) by a rotation vector, and by a shift
    over the depth."""
    x, y = points.T
    zero, one = np.zeros_like(x), np.ones_like(x)
    of_x = -x * y, 1 + x * x, -y, one, zero, -x
    of_y = -1 - y * y, x * y, x, zero, one, -y
    return np.stack([np.stack(of_x, -1), np.stack(of_y, -1)], 1)


def _errors(
    x1: np.ndarray, x2: np.ndarray, R: np.ndarray, t: np.ndarray
) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """What is left of the matches (N, 2) at the median depth, the parallax there (N, 2), and the
    derivatives (N, 2, 6)."""
    turned = homogeneous(x1) @ R.T
    turned = turned[:, :2] / turned[:, 2:]
    slopes = _slopes(turned)
    parallax = slopes[..., 3:] @ t
    return x2 - turned - parallax, parallax, slopes


def _fit(
    x1: np.ndarray,
    x2: np.ndarray,
    weights: np.ndarray,
    pixel: float,
    R: np.ndarray,
    t: np.ndarray,
    std: float,
    steps: int,
) -> _Fit:
    """The motion near a start. std: of a match, from which it narrows to that of the matches."""
    prior = np.diag([1e-6] * 3 + [1 / _SHIFT_STD**2] * 3)
    least, most = np.multiply(_NOISE, pixel)
    std = max(std, most)
    for step in range(steps + 1):
        left, parallax, slopes = _errors(x1, x2, R, t)
        length = np.linalg.norm(parallax, axis=1)
        along = np.where(length[:, None] > 0, parallax, [1.0, 0]) / np.where(length > 0, length, 1)[:, None]
        axes = np.stack([along, along[:, ::-1] * (-1, 1)], 1)
        stds = np.column_stack([np.hypot(std, _DEPTH_STD * length), np.full(len(x1), std)])
        errors = np.einsum("nki,ni->nk", axes, left) / stds
        scaled = axes @ slopes / stds[..., None]
        depth = 1 + _DEPTH_STD**2 * (left * parallax).sum(1) / stds[:, 0] ** 2  # inverse, likeliest
        scaled[:, 1, 3:] *= depth.clip(0, 4)[:, None]
        alike = np.square(stds[:, 0]) / (std**2 + _DEPTHS_ALIKE * np.square(_DEPTH_STD * length))
        each = weights[:, None] * np.column_stack([alike, np.ones(len(x1))])
        if step == steps:
            break
        robust = each / (1 + np.square(errors / EFFICIENT))
        information = np.einsum("nk,nki,nkj->ij", robust, scaled, scaled) + prior
        gradient = np.einsum("nk,nki,nk->i", robust, scaled, errors)
        gradient[3:] -= prior[3:, 3:] @ t
        move = np.linalg.solve(information, gradient)
        R, t = cv2.Rodrigues(move[:3])[0] @ R, t + move[3:]
        t *= min(1, 5 * _SHIFT_STD / max(float(np.linalg.norm(t)), 1e-9))
        noise = np.abs(errors[:, 1]) if np.median(length) > least else np.hypot(*errors.T) / 1.5
        order = np.argsort(noise)
        total = np.cumsum(weights[order])
        quarter = std * noise[order][np.searchsorted(total, total[-1] / 4)] / 0.3186
        std = max(0.7 * std, most) if std > most else float(np.clip(quarter, least, most))
    density = np.exp(-np.square(errors).sum(1) / 2) / (2 * np.pi * stds.prod(1))
    of_object = np.square(x2 - x1).sum(1) / _OBJECT**2
    other = 0.05 + 0.1 * np.exp(-of_object / 2) / (2 * np.pi * _OBJECT**2)
    score = float(weights @ np.log(0.85 * density + other)) / float(weights.sum())
    return _Fit(R, t, std, errors, scaled, each, score)


def _apparent_motion_deg(
    fit: _Fit, covariance: np.ndarray, x1: np.ndarray
) -> tuple[np.ndarray, np.ndarray]:
    """By how much the picture moves at points of median depth, and its error, (N,)."""
    motion = np.linalg.norm(_errors(x1, x1, fit.R, fit.t)[0], axis=1)
    slopes = _slopes(x1)
    error = NORMAL_90 * np.sqrt(np.einsum("nki,ij,nkj->n", slopes, covariance, slopes))
    return np.degrees(motion), np.degrees(error)


def _left_in_place(fit: _Fit, x1: np.ndarray) -> np.ndarray:
    """The probability (N,) that a point which moves with the picture seems to stay."""
    left, parallax, _ = _errors(x1, x1, fit.R, fit.t)
    length = np.linalg.norm(parallax, axis=1)
    variance = fit.std**2 + np.square(_DEPTH_STD * length)
    along = (left * parallax).sum(1) / np.maximum(length, 1e-12)
    across = np.square(left).sum(1) - along**2
    exponent = along**2 / variance + across / fit.std**2
    area = 9 * fit.std / (2 * np.sqrt(variance))
    probability: np.ndarray = np.minimum(1, area * np.exp(-exponent / 2))
    return probability


def _covariance(fit: _Fit, x2: np.ndarray) -> np.ndarray:
    """The covariance (6, 6) of a rotation vector and t: by the jackknife over blocks, and as if
    each cell were independent."""
    inliers = fit.inliers
    errors, slopes = fit.errors[inliers].ravel(), fit.slopes[inliers].reshape(-1, 6)
    terms = loss_terms(errors, slopes, EFFICIENT) * fit.weights[inliers].reshape(-1, 1)
    information = terms[:, :36].sum(0).reshape(6, 6)
    information += np.diag([1e-6] * 3 + [1 / _SHIFT_STD**2] * 3)
    points = np.repeat(x2[inliers], 2, axis=0)
    blocks = [jackknife(information, block_sums(terms, points, by), KEPT) for by in SHIFTS]
    covariance: np.ndarray = np.mean(blocks, 0) + np.linalg.inv(information)
    return _ERROR_SCALE**2 * covariance
