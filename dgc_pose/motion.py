"""Whether a fixed camera has moved between two pictures, and by how much.

A match goes from the normalised point x1 to x2 = project(R x1) + rho g(t): the rotation, and the
parallax g of a shift t, in median depths, times the inverse depth rho, about 1. Across the parallax
a match errs by its noise alone; along it, rho is not known either. R and t minimise a Cauchy loss
of both errors. A rotation alone, t = 0, is no special case. People and objects are outliers, and
each cell of the picture has the same weight, so that textured objects do not outvote walls.
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

STILL_DEG = 0.05  # the picture of a still camera moves by less, with the error added
# The picture of a moved camera moves by more, with so many times the error subtracted.
_LEAST_DEG, _SIGNIFICANT = 0.01, 2.0
_MOST = 0.9  # share of the picture that these hold for
_CELLS = 16  # along the longer side of the picture
_MIN_MATCHES, _COVERED = 50, 0.1  # the second is the least share of all cells that agree
# Shares of the matched cells: the least that agree on a motion; the least that stay although the
# motion would move them, so that what moves are objects; and the most that stay if all has moved.
_AGREE, _STAY, _NOTHING = 0.4, 0.15, 0.1
_DEPTH_STD, _SHIFT_STD = 0.5, 0.1  # of rho, and of t by its prior
_PRIOR = np.diag([1e-6] * 3 + [1 / _SHIFT_STD**2] * 3)  # information of a rotation vector and t
_NOISE = 0.16, 0.5  # bounds of the standard deviation of a match, in its expected error
_INLIER, _OUTLIER, _STAYS = 3.6, 8.0, 3.0  # largest errors, in standard deviations
_ERROR_SCALE = 1.3  # chosen on simulated pairs
_SAMPLES, _LOOSE, _WIDE = 200, 0.02, 8.0  # rotations; their threshold; standard deviation at first
_STEPS = 40


@dataclass(frozen=True)
class CameraMotion:
    """The motion of a camera since the reference picture.

    Attributes:
        verdict: "still": the picture moves by less than 0.05 degrees. "moved": it moves
            significantly. "cannot say": `reason` has why.
        reason: One line for people.
        angle_deg: Angle of the rotation, degrees; None without enough matches.
        angle_error_90_deg: Error of the angle, degrees, that nine in ten stay below.
        shift: Distance between the camera centres over the median depth of the matched scene.
        shift_error_90: Error of the shift, in the same unit, that nine in ten stay below.
        num_matches: Number of matches.
        num_inliers: Number of matches that agree with the motion.
        warnings: Sentences about what makes the result uncertain, for people.
        seconds: Time by what was done: "load", "match", "estimate".
    """

    verdict: Literal["still", "moved", "cannot say"]
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


def camera_motion(
    reference: ImageSource,
    now: ImageSource,
    K: CameraSource = None,
    *,
    matcher: MatcherSource = None,
) -> CameraMotion:
    """Whether a fixed camera has moved since the reference picture, by which angle and shift.

    reference, now: paths, arrays (H, W[, 3]) in RGB order, or tensors, of one size. K: as of
    `estimate_relative_pose`; without it the focal length is assumed, and its uncertainty is part of
    the errors. matcher: by default `load_matcher()`, or its name; load it once for many pictures.

    Raises ImageError if an image cannot be read, InputError (a ValueError) if another argument is
    unusable or the sizes differ, WeightsError if the network's weights cannot be loaded.

    >>> camera_motion("installed.jpg", "today.jpg", K).verdict  # doctest: +SKIP
    """
    start = time.perf_counter()
    first, second = load_image(reference, "reference"), load_image(now, "now")
    if first.size != second.size:
        names = (f"{image.name} has {image.size[0]} x {image.size[1]}" for image in (second, first))
        raise InputError(ArgumentName("now"), "has another size: " + ", ".join(names))
    check_type(matcher, Matcher | str | Path | None, "matcher")
    camera = pair_cameras(K, K, first, first, ("K", "K"))[0]
    matcher = DEFAULT_WEIGHTS if matcher is None else matcher
    matcher = load_matcher(matcher) if isinstance(matcher, str | Path) else matcher
    loaded = time.perf_counter()
    matches = matcher.match(first, second).matches
    matched = time.perf_counter()
    motion = _motion(matches, camera, first.size)
    seconds = {"load": loaded - start, "match": matched - loaded}
    seconds["estimate"] = time.perf_counter() - matched
    return replace(motion, warnings=camera.warnings, seconds=seconds)


class _Fit(NamedTuple):
    """A motion, and the N matches' errors over their standard deviations."""

    R: np.ndarray  # (3, 3)
    t: np.ndarray  # (3,), in median depths
    std: float  # standard deviation of a match, normalised
    errors: np.ndarray  # (N, 2), along and across the parallax
    slopes: np.ndarray  # (N, 2, 6), minus their derivatives by a rotation vector, radians, and t
    weights: np.ndarray  # (N,)
    score: float  # log likelihood, in cells
    inliers: np.ndarray  # (N,) bool


@one_blas_thread()
def _motion(matches: Matches, camera: Camera, size: tuple[int, int]) -> CameraMotion:
    """The motion by the matches of two pictures of a size (width, height)."""
    points = camera.normalise(matches.points1), camera.normalise(matches.points2)
    usable = np.isfinite(np.hstack(points)).all(1)
    x1, x2 = points[0][usable], points[1][usable]
    if len(x1) < _MIN_MATCHES:
        return CameraMotion("cannot say", f"only {len(x1)} matches", num_matches=len(x1))
    cell = max(size) / _CELLS
    cells = np.floor(matches.points1[usable] / cell) @ (1, _CELLS + 1)
    _, of_cell, count = np.unique(cells, return_inverse=True, return_counts=True)
    weights, pixel = 1 / count[of_cell], matches.error_px / camera.focal

    def most(values: np.ndarray) -> float:
        """What the values stay below in most of the picture that agrees with the motion."""
        order = np.argsort(values)
        total = np.cumsum((weights * fit.inliers)[order])
        return float(values[order][np.searchsorted(total, _MOST * total[-1])])

    def share(part: np.ndarray) -> float:
        return float(weights @ part) / len(count)

    at_rest, common, none = np.eye(3), _common_rotation(x1, x2, weights), np.zeros(3)
    apart = max(float(np.median(np.linalg.norm(_errors(x1, x2, common, none)[0], axis=1))), pixel)
    shifts = apart * np.diag([1.0, 1, 2])
    starts = [(at_rest, none, 0.0)]  # the loss has several minima
    starts += [(common, shift, _WIDE * pixel) for shift in (none, *shifts, *-shifts)]
    fits = [_fit(x1, x2, weights, pixel, *start) for start in starts]
    fit = max(fits, key=lambda fit: fit.score)
    covariance, motion, error = _uncertainty(fit, x1)
    stay = np.linalg.norm(x2 - x1, axis=1) < _STAYS * fit.std
    moved = most(motion - _SIGNIFICANT * error) > _LEAST_DEG
    moved |= most(motion) > STILL_DEG and share(stay) < _NOTHING
    against = stay & (np.radians(motion) > 2 * _STAYS * fit.std)
    if share(against) > _STAY if moved else share(stay) > _AGREE:
        moved = False  # all else is people and objects
        fit = _fit(x1, x2, weights * stay, pixel, at_rest, none, 0.0)
        covariance, motion, error = _uncertainty(fit, x1)
    agree, numbers = share(fit.inliers), (len(x1), int(fit.inliers.sum()))
    covers = agree * len(count) * cell**2 / (size[0] * size[1])
    verdict: Literal["still", "moved", "cannot say"] = "cannot say"
    if agree < (_AGREE if moved else _STAY) or covers < _COVERED:
        of = f"{100 * agree:.0f} % of the matched picture, {100 * covers:.0f} % of all,"
        reason = f"only {of} agrees on one motion"
        return CameraMotion(verdict, reason, num_matches=numbers[0], num_inliers=numbers[1])
    if moved:
        verdict = "moved"
        reason = f"{100 * agree:.0f} % of the matched picture moves by {most(motion):.3g} deg"
    elif (bound := most(motion + error)) < STILL_DEG:
        verdict, reason = "still", f"the picture moves by less than {bound + 5e-4:.3f} deg"
    else:
        reason = f"the picture moves by {most(motion):.3f} +- {most(error):.3f} deg"
    angle, shift = rotation_angle_deg(fit.R), float(np.linalg.norm(fit.t))
    errors = NORMAL_90 * np.sqrt([covariance[:3, :3].trace(), covariance[3:, 3:].trace()])
    # With a wrong focal length a rotation passes for a shift in part, and the other way round.
    of_focal = NORMAL_90 * camera.focal_std * (math.radians(angle) + shift)
    angle_error = math.degrees(math.hypot(errors[0], of_focal))
    shift_error = math.hypot(errors[1], of_focal)
    return CameraMotion(verdict, reason, angle, angle_error, shift, shift_error, *numbers)


def _common_rotation(x1: np.ndarray, x2: np.ndarray, weights: np.ndarray) -> np.ndarray:
    """The rotation (3, 3) that most of the picture agrees with, among those of random pairs of
    matches."""
    rng, rays1, rays2 = np.random.default_rng(0), unit_rays(x1), unit_rays(x2)
    pairs = rng.choice(len(x1), (_SAMPLES, 2), p=weights / weights.sum())
    rotations = [aligning_rotation(rays1[pair], rays2[pair]) for pair in pairs]
    squared = [np.square(rays1 @ R.T - rays2).sum(1) for R in rotations]
    return rotations[np.argmax([weights @ (1 / (1 + part / _LOOSE**2)) for part in squared])]


def _fit(
    x1: np.ndarray,
    x2: np.ndarray,
    weights: np.ndarray,
    pixel: float,
    R: np.ndarray,
    t: np.ndarray,
    std: float,
) -> _Fit:
    """Gauss-Newton steps from R and t. pixel: expected error of a match,
    normalised. std: standard deviation of a match at the start; each step narrows it, down to what
    the best quarter of the picture shows."""
    least, most = np.multiply(_NOISE, pixel)
    std = max(std, most)
    for step in range(_STEPS + 1):
        left, parallax, slopes = _errors(x1, x2, R, t)
        length = np.linalg.norm(parallax, axis=1)[:, None]
        along = np.where(length > 0, parallax, (1.0, 0)) / np.where(length > 0, length, 1)
        axes = np.stack([along, along[:, ::-1] * (-1, 1)], 1)
        spread = _DEPTH_STD * length
        stds = np.hstack([np.hypot(std, spread), np.full_like(spread, std)])
        errors = np.einsum("nki,ni->nk", axes, left) / stds
        rho = 1 + spread[:, 0] * _DEPTH_STD * errors[:, 0] / stds[:, 0]
        slopes = axes @ slopes / stds[..., None]
        slopes[:, 1, 3:] *= rho.clip(0, 4)[:, None]
        if step == _STEPS:
            break
        robust = weights[:, None] / (1 + np.square(errors / EFFICIENT))
        robust *= (np.abs(errors) < _OUTLIER).all(1)[:, None]
        gradient = np.einsum("nk,nki,nk->i", robust, slopes, errors) - _PRIOR @ [0, 0, 0, *t]
        move = np.linalg.solve(
            np.einsum("nk,nki,nkj->ij", robust, slopes, slopes) + _PRIOR, gradient
        )
        R, t = cv2.Rodrigues(move[:3])[0] @ R, t + move[3:]
        t = t * min(1, 5 * _SHIFT_STD / max(float(np.linalg.norm(t)), _SHIFT_STD))
        noise = np.abs(errors[:, 1]) if np.median(length) > least else np.hypot(*errors.T) / 1.5
        order = np.argsort(noise)
        quarter = np.searchsorted(np.cumsum(weights[order]), weights.sum() / 4)
        shown = std * noise[order][quarter] / 0.3186  # of a Gaussian's quartile
        std = max(0.7 * std, most) if std > most else float(np.clip(shown, least, most))
    density = np.exp(-np.square(errors).sum(1) / 2) / (2 * np.pi * stds.prod(1))
    score = float(weights @ np.log(0.9 * density + 0.1))  # one match in ten is wrong
    return _Fit(R, t, std, errors, slopes, weights, score, (np.abs(errors) < _INLIER).all(1))


def _errors(
    x1: np.ndarray, x2: np.ndarray, R: np.ndarray, t: np.ndarray
) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """The errors (N, 2) of matches at the median depth, the parallax (N, 2) there, and the
    derivatives (N, 2, 6) of x2 by a rotation vector and t."""
    turned = homogeneous(x1) @ R.T
    x, y = (turned[:, :2] / turned[:, 2:]).T
    zero, one = np.zeros_like(x), np.ones_like(x)
    of_x = np.stack([-x * y, 1 + x * x, -y, one, zero, -x], -1)
    of_y = np.stack([-1 - y * y, x * y, x, zero, one, -y], -1)
    slopes = np.stack([of_x, of_y], 1)
    parallax = slopes[..., 3:] @ t
    return x2 - np.column_stack([x, y]) - parallax, parallax, slopes


def _uncertainty(fit: _Fit, x1: np.ndarray) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """The covariance (6, 6) of a rotation vector and t: that of the jackknife over blocks, and that
    of independent cells. The motion (N,) of the picture at points of median depth, degrees, and the
    error (N,) that nine in ten stay below."""
    inliers = fit.inliers if fit.inliers.any() else np.ones_like(fit.inliers)
    errors, slopes = fit.errors[inliers].ravel(), fit.slopes[inliers].reshape(-1, 6)
    terms = loss_terms(errors, slopes, EFFICIENT) * np.repeat(fit.weights[inliers], 2)[:, None]
    information = terms[:, :36].sum(0).reshape(6, 6) + _PRIOR
    points = np.repeat(x1[inliers], 2, axis=0)
    blocks = [jackknife(information, block_sums(terms, points, by), KEPT) for by in SHIFTS]
    covariance = _ERROR_SCALE**2 * (np.mean(blocks, 0) + np.linalg.inv(information))
    slopes = _errors(x1, x1, np.eye(3), np.zeros(3))[2]
    error = NORMAL_90 * np.sqrt(np.einsum("nki,ij,nkj->n", slopes, covariance, slopes))
    motion = np.linalg.norm(_errors(x1, x1, fit.R, fit.t)[0], axis=1)
    return covariance, np.degrees(motion), np.degrees(error)
