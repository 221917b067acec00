"""Whether a fixed camera has moved between two pictures, and by how much.

A match maps the normalised point x1 to x2 = project(R x1) + rho g(t). R is the rotation, t the
shift in median depths, g(t) its parallax, and rho, about 1, the inverse depth. Across the parallax
the error of a match is noise; along it, the unknown rho adds to the noise. R and t minimise a
Cauchy loss of both errors. A pure rotation, t = 0, is no special case. People and objects are
outliers. All cells of the picture have the same weight: textured objects do not outvote walls.
"""

from __future__ import annotations

import math
import time
from collections.abc import Mapping
from dataclasses import asdict, dataclass, field, replace
from functools import partial
from pathlib import Path
from typing import TYPE_CHECKING, Any, Literal, NamedTuple

import cv2
import numpy as np

from dgc_pose.cameras.calibration import image_camera
from dgc_pose.cameras.camera import Camera
from dgc_pose.cameras.prior import with_lines
from dgc_pose.errors import ArgumentName, InputError
from dgc_pose.estimation.covariance import NORMAL_90
from dgc_pose.estimation.least_squares import EFFICIENT, KEPT, block_jackknife, loss_terms
from dgc_pose.geometry.epipolar import homogeneous, unit_rays
from dgc_pose.geometry.rotation import aligning_rotation, rotation_angle_deg
from dgc_pose.images.image import load_image
from dgc_pose.matchers import load_matcher
from dgc_pose.matches import Matches
from dgc_pose.matching import DEFAULT_WEIGHTS, Matcher
from dgc_pose.system.options import check_type
from dgc_pose.system.parallel import one_blas_thread

if TYPE_CHECKING:
    from dgc_pose.pose import CameraSource, ImageSource, MatcherSource

STILL_DEG = 0.05  # the camera is still if the motion of the picture plus its error is less
# The camera has moved if the motion of the picture exceeds this and this many times its error.
_LEAST_DEG, _SIGNIFICANT = 0.01, 2.0
_MOST = 0.9  # quantile of the motion over the picture that these limits apply to
_CELLS = 16  # along the longer side of the picture
_MIN_MATCHES, _COVERED = 50, 0.1  # the second is the least share of the picture that agrees
# Shares of the matched cells: the least that agree on a motion; the least that stay although the
# motion would move them, so only objects moved; the most that stay if the camera moved.
_AGREE, _STAY, _NOTHING = 0.4, 0.15, 0.1
_MAJORITY = 0.6  # a larger part that moves together may be the scene behind a still lens hood
_MIRRORED = 0.3  # share of random triangles that are mirrored: real motions mirror up to 0.21
_DEPTH_STD, _SHIFT_STD = 0.5, 0.1  # standard deviations of rho, and of the prior of t
_PRIOR = np.diag([1e-6] * 3 + [1 / _SHIFT_STD**2] * 3)  # information of a rotation vector and t
_NOISE = 0.16, 0.5  # bounds of the standard deviation of a match, over its expected error
_INLIER, _OUTLIER, _STAYS = 3.6, 8.0, 3.0  # largest errors, in standard deviations
_ERROR_SCALE = 1.3  # chosen on simulated pairs
# Random triples; their threshold; the first standard deviation of a match, over its expected error.
_SAMPLES, _LOOSE, _WIDE = 200, 0.02, 8.0
_STEPS = 20


@dataclass(frozen=True)
class CameraMotion:
    """The motion of a camera since the reference picture.

    Attributes:
        verdict: "still": the picture moves by less than 0.05 degrees. "moved": it moves
            significantly. "cannot say": `reason` states why.
        reason: One line for people.
        angle_deg: Angle of the rotation, degrees; None if the matches show no single motion.
        angle_error_90_deg: Bound of its error in nine cases of ten, degrees.
        shift: Distance between the camera centres over the median depth of the matched scene.
        shift_error_90: Bound of its error in nine cases of ten, in the same unit.
        num_matches: Number of matches.
        num_inliers: Number of matches that agree with the motion.
        warnings: Sentences about what makes the result uncertain, for people.
        seconds: Time spent on "load", "match" and "estimate".
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
    """Whether a fixed camera has moved since the reference picture, and by which angle and shift.

    reference, now: paths, arrays (H, W[, 3]) in RGB order, or tensors, of one size. K: as for
    `estimate_relative_pose`; without K the focal length is assumed, and its uncertainty is part of
    the errors. matcher: by default `load_matcher()`; or a name. For many pictures, load it once.

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
    (camera,) = with_lines([image_camera(K, first)], [first])
    matcher = DEFAULT_WEIGHTS if matcher is None else matcher
    matcher = load_matcher(matcher) if isinstance(matcher, str | Path) else matcher
    loaded = time.perf_counter()
    matches = matcher.match(first, second).matches
    matched = time.perf_counter()
    motion = _motion(matches, camera, first.size)
    seconds = {"load": loaded - start, "match": matched - loaded}
    seconds["estimate"] = time.perf_counter() - matched
    return replace(motion, warnings=camera.warnings, seconds=seconds)


class _Matched(NamedTuple):
    """N matches in normalised points."""

    x1: np.ndarray  # (N, 2)
    x2: np.ndarray  # (N, 2)
    weights: np.ndarray  # (N,), with sum 1 in each cell of the picture
    pixel: float  # expected error of a match


class _Fit(NamedTuple):
    """A motion, and its values at N matches."""

    R: np.ndarray  # (3, 3)
    t: np.ndarray  # (3,), in median depths
    std: float  # standard deviation of a match, normalised
    agree: np.ndarray  # (N,), weights of the matches that agree, 0 for all others
    covariance: np.ndarray  # (6, 6), of a rotation vector, radians, and t
    moves: np.ndarray  # (N,), degrees by which the picture moves at median depth
    error: np.ndarray  # (N,), degrees, bound of the error of `moves` in nine cases of ten


@one_blas_thread()
def _motion(matches: Matches, camera: Camera, size: tuple[int, int]) -> CameraMotion:
    """The motion from the matches of two pictures. size: (width, height) of both."""
    x1, x2 = camera.normalise(matches.points1), camera.normalise(matches.points2)
    usable, cell = np.isfinite(x1 + x2).all(1), max(size) / _CELLS
    number = int(usable.sum())
    if number < _MIN_MATCHES:
        return CameraMotion("cannot say", f"only {number} matches", num_matches=number)
    cells = np.floor(matches.points1[usable] / cell) @ (1, _CELLS + 1)
    _, index, count = np.unique(cells, return_inverse=True, return_counts=True)
    pixel = matches.error_px / camera.focal
    matched = _Matched(x1[usable], x2[usable], 1 / count[index], pixel)
    common, mirrored = _sampled(matched)
    fit, moved, doubt = _decided(matched, common)
    agree = fit.agree.sum() / len(count)
    covers = fit.agree.sum() * cell**2 / (size[0] * size[1])
    of = partial(CameraMotion, num_matches=number, num_inliers=int(np.count_nonzero(fit.agree)))
    if agree < (_AGREE if moved else _STAY) or covers < _COVERED:
        parts = f"{100 * agree:.0f} % of the matched picture, {100 * covers:.0f} % of all,"
        return of("cannot say", f"only {parts} agrees on one motion")
    if doubt:
        return of("cannot say", doubt)
    if moved and mirrored > _MIRRORED:
        return of("cannot say", "the matches fit a mirror image")
    sizes, moves = _sizes(fit, camera), _below(fit.moves, fit.agree)
    bound, error = _below(fit.moves + fit.error, fit.agree), _below(fit.error, fit.agree)
    if moved and bound >= STILL_DEG:
        reason = f"{100 * agree:.0f} % of the matched picture moves by {moves:.3g} deg"
        return of("moved", reason, *sizes)
    if bound < STILL_DEG:
        return of("still", f"the picture moves by less than {bound + 5e-4:.3f} deg", *sizes)
    return of("cannot say", f"the picture moves by {moves:.3f} +- {error:.3f} deg", *sizes)


def _sizes(fit: _Fit, camera: Camera) -> tuple[float, float, float, float]:
    """The angle and its error, degrees, and the shift and its error, median depths."""
    angle, shift = rotation_angle_deg(fit.R), float(np.linalg.norm(fit.t))
    variances = fit.covariance.diagonal().reshape(2, 3).sum(1)
    # A wrong focal length makes part of a rotation look like a shift, and the reverse.
    of_focal = camera.focal_std * (math.radians(angle) + shift)
    angle_error, shift_error = NORMAL_90 * np.sqrt(variances + of_focal**2)
    return angle, math.degrees(angle_error), shift, float(shift_error)


def _sampled(matched: _Matched) -> tuple[np.ndarray, float]:
    """The rotation (3, 3), from random triples of matches, that most of the picture agrees with;
    and the share of the triples whose triangle is mirrored."""
    rng, rays1, rays2 = np.random.default_rng(0), unit_rays(matched.x1), unit_rays(matched.x2)
    weights = matched.weights / matched.weights.sum()
    triples = rng.choice(len(weights), (_SAMPLES, 3), p=weights)
    mirrored = np.linalg.det(rays1[triples]) * np.linalg.det(rays2[triples]) < 0
    rotations = [aligning_rotation(rays1[triple], rays2[triple]) for triple in triples]
    squared = [np.square(rays1 @ R.T - rays2).sum(1) for R in rotations]
    best = np.argmax([weights @ (1 / (1 + part / _LOOSE**2)) for part in squared])
    return rotations[best], float(mirrored.mean())


def _decided(matched: _Matched, common: np.ndarray) -> tuple[_Fit, bool, str]:
    """The motion; whether the camera moved; and why that is open, or "". Fits start at rest and at
    the rotation `common` (3, 3). If only people or objects moved, the matches that stay decide."""
    x1, x2, weights, pixel = matched
    wide = _WIDE * pixel
    starts = (np.eye(3), 0.0), (np.eye(3), wide), (common, wide)  # the loss has several minima
    fit = max((_fit(matched, *start) for start in starts), key=lambda fit: fit.agree.sum())
    stay = np.linalg.norm(x2 - x1, axis=1) < _STAYS * fit.std
    against = stay & (np.radians(fit.moves) > 2 * _STAYS * fit.std)
    stays, stays_against = np.array([stay, against]) @ weights / weights.sum()
    moved = _below(fit.moves - _SIGNIFICANT * fit.error, fit.agree) > _LEAST_DEG
    moved |= _below(fit.moves, fit.agree) > STILL_DEG and stays < _NOTHING
    share = fit.agree.sum() / weights.sum()
    if moved and stays_against > _STAY and share > _MAJORITY:
        angle = _below(fit.moves, fit.agree)
        both = f"moves by {angle:.3g} deg, and {100 * stays_against:.0f} % stays"
        return fit, moved, f"{100 * share:.0f} % of the matched picture {both}"
    if stays_against > _STAY if moved else stays > _AGREE:
        return _fit(matched._replace(weights=weights * stay), np.eye(3), 0.0), False, ""
    return fit, moved, ""


def _fit(matched: _Matched, R: np.ndarray, std: float) -> _Fit:
    """The motion by Gauss-Newton steps from a rotation (3, 3). std: first standard deviation of a
    match; each step reduces it, down to that of the best quarter of the picture."""
    x1, _, weights, pixel = matched
    t, (least, most) = np.zeros(3), np.multiply(_NOISE, pixel)
    std = max(std, most)
    for _ in range(_STEPS):
        errors, slopes = _errors(matched, R, t, std)
        robust = weights[:, None] / (1 + np.square(errors / EFFICIENT))
        robust *= (np.abs(errors) < _OUTLIER).all(1)[:, None]
        gradient = np.einsum("nk,nki,nk->i", robust, slopes, errors) - _PRIOR[:, 3:] @ t
        information = np.einsum("nk,nki,nkj->ij", robust, slopes, slopes) + _PRIOR
        move = np.linalg.solve(information, gradient)
        R, t = cv2.Rodrigues(move[:3])[0] @ R, t + move[3:]
        shown = std * _below(np.abs(errors[:, 1]), weights, 0.25) / 0.3186  # of |x|, Gaussian
        std = max(0.7 * std, least, min(shown, most))
    errors, slopes = _errors(matched, R, t, std)
    inliers = (np.abs(errors) < _INLIER).all(1)
    some = np.repeat(inliers if inliers.any() else ~inliers, 2)
    terms = loss_terms(errors.ravel(), slopes.reshape(-1, 6), EFFICIENT)
    terms, points = (terms * np.repeat(weights, 2)[:, None])[some], np.repeat(x1, 2, axis=0)[some]
    information = terms[:, :36].sum(0).reshape(6, 6) + _PRIOR
    blocks = block_jackknife(information, terms, points, KEPT)
    covariance = _ERROR_SCALE**2 * (blocks + np.linalg.inv(information))
    slopes = _seen(x1, np.eye(3), t)[2]
    error = NORMAL_90 * np.sqrt(np.einsum("nki,ij,nkj->n", slopes, covariance, slopes))
    seen, parallax, _ = _seen(x1, R, t)
    moves = np.degrees(np.linalg.norm(seen + parallax - x1, axis=1))
    return _Fit(R, t, std, weights * inliers, covariance, moves, np.degrees(error))


def _errors(
    matched: _Matched, R: np.ndarray, t: np.ndarray, std: float
) -> tuple[np.ndarray, np.ndarray]:
    """The errors (N, 2) of matches, along and across the parallax, over their standard deviations;
    and minus their derivatives (N, 2, 6) by a rotation vector, radians, and t."""
    seen, parallax, slopes = _seen(matched.x1, R, t)
    direction = parallax + (1e-12, 0.0)  # any direction if there is no parallax
    length = np.linalg.norm(direction, axis=1, keepdims=True)
    along, spread = direction / length, _DEPTH_STD * length
    axes = np.stack([along, along[:, ::-1] * (-1, 1)], 1)
    stds = np.hstack([np.hypot(std, spread), np.full_like(spread, std)])
    errors = np.einsum("nki,ni->nk", axes, matched.x2 - seen - parallax) / stds
    slopes = axes @ slopes / stds[..., None]
    rho = 1 + _DEPTH_STD * spread[:, 0] * errors[:, 0] / stds[:, 0]
    slopes[:, 1, 3:] *= rho.clip(0, 4)[:, None]
    return errors, slopes


def _seen(
    x1: np.ndarray, R: np.ndarray, t: np.ndarray
) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """The points (N, 2) after a rotation, their parallax (N, 2) at the median depth, and the
    derivatives (N, 2, 6) by a rotation vector, radians, and t."""
    turned = homogeneous(x1) @ R.T
    x, y = (turned[:, :2] / turned[:, 2:]).T
    of_x = np.stack([-x * y, 1 + x * x, -y, 1 + 0 * x, 0 * x, -x], -1)
    of_y = np.stack([-1 - y * y, x * y, x, 0 * y, 1 + 0 * y, -y], -1)
    slopes = np.stack([of_x, of_y], 1)
    return np.column_stack([x, y]), slopes[..., 3:] @ t, slopes


def _below(values: np.ndarray, weights: np.ndarray, share: float = _MOST) -> float:
    """The weighted quantile of values (N,) at a share of all weights (N,)."""
    order = np.argsort(values)
    total = np.cumsum(weights[order])
    return float(values[order][np.searchsorted(total, share * total[-1])])
