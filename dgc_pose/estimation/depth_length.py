"""The length of t from depths at the inliers; and whether these are z or distances along the rays.

A distance along a ray is z times the secant of the ray's angle to the optical axis. So single
lengths, depth over triangulated z, are equal for z and grow with the secant for distances: the
slope of their logarithms is 0 or 1.
"""

import math
from collections.abc import Sequence

import numpy as np

from dgc_pose.errors import InputError
from dgc_pose.estimation.least_squares import DEVIATION, EFFICIENT
from dgc_pose.geometry.epipolar import depths, essential_from_pose, homogeneous, sampson_distance

_MIN_DEPTHS = 10  # inliers with a known depth that a length needs
_CORRELATED = 30.0  # neighbouring depths that count as one, because their errors are correlated
_RAYS = 0.1  # prior probability of distances along the rays
_SLOPE_STD = 0.2  # of errors of the slope that neither the pose nor the depths state, as of K
_STEPS = 10  # of the fit of the slope
_EXACT = 1e-9  # least width of its loss, for exact depths; secants that differ less are equal

Rays = tuple[np.ndarray, np.ndarray]  # normalised points (N, 2) of the inliers in both images


def inverse_depths(
    x1: np.ndarray, x2: np.ndarray, R: np.ndarray, t: np.ndarray
) -> tuple[np.ndarray, np.ndarray]:
    """1 / depth (N,) in camera 1, unit 1 / |t|, and its deviation (N,) from the error of matches:
    with the depth, points in image 2 move along epipolar lines."""
    error = DEVIATION * float(np.median(sampson_distance(x1, x2, essential_from_pose(R, t))))
    inverse = 1 / depths(x1, x2, R, t)[0]
    ratio = homogeneous(x1) @ R[2] + inverse * t[2]  # of the depths in cameras 2 and 1
    moved = np.linalg.norm(t[:2] - t[2] * x2, axis=1) / np.abs(ratio)
    return inverse, math.sqrt(2) * error / moved


def secants(rays: Rays) -> np.ndarray:
    """Distances along the rays over z (2, N), in each camera."""
    return np.linalg.norm([homogeneous(x) for x in rays], axis=2)


def length_by_depths(
    rays: Rays, z: np.ndarray, depth_std: float, doubt: float, R: np.ndarray, t: np.ndarray
) -> tuple[float, float, float]:
    """The length, its deviation, and the scatter of single lengths in their deviations.

    z: depths (2, N) in each camera, metres, NaN if unknown. depth_std: their relative deviation, of
    each and of their common scale. doubt: probability that distances along the rays are taken for z
    or the reverse, which widens the deviation. R, t: pose of the inliers, t of unit length. Raises
    InputError if too few depths are known.
    """
    known = np.isfinite(z)
    inliers = int(known.any(0).sum())
    if inliers < _MIN_DEPTHS:
        raise InputError(f"{inliers} inliers have a depth, and {_MIN_DEPTHS} are needed")
    single, by_match = (part[known] for part in _single_lengths(rays, z, R, t))
    length = float(np.median(single))
    off = np.abs(single - length)
    scatter = DEVIATION * float(np.median(off / np.hypot(by_match, depth_std * length)))
    count = max(inliers / _CORRELATED, 1.0)
    own = DEVIATION * float(np.median(off)) / count**0.5
    other = length - float(np.median(single / secants(rays)[known]))
    return length, math.hypot(depth_std * length, own, math.sqrt(doubt) * other), scatter


def ray_probability(
    rays: Rays,
    z: np.ndarray,
    depth_std: float,
    pose: tuple[np.ndarray, np.ndarray],
    deviating: Sequence[tuple[np.ndarray, np.ndarray]],
) -> float:
    """Probability that depths are distances along the rays. pose: R and t of the inliers.
    deviating: poses one deviation off it; see `length_by_depths` for the other arguments."""
    if not deviating:  # without a covariance, the error of the slope is not known
        return _RAYS
    slope, std = _slope(rays, z, depth_std, *pose)
    moved = [_slope(rays, z, depth_std, *other)[0] - slope for other in deviating]
    variance = _SLOPE_STD**2 + std**2 + sum(np.square(moved))
    log_odds = math.log(_RAYS / (1 - _RAYS)) + (slope - 0.5) / variance
    return 0.5 + 0.5 * math.tanh(log_odds / 2)


def _slope(
    rays: Rays, z: np.ndarray, depth_std: float, R: np.ndarray, t: np.ndarray
) -> tuple[float, float]:
    """The slope of ln single length by ln secant, and its deviation, infinite if too few depths are
    known or the secants do not differ. By a Cauchy loss."""
    lengths, by_match = _single_lengths(rays, z, R, t)
    with np.errstate(invalid="ignore"):
        good = (lengths > 0) & (lengths < np.inf)
    x = np.log(secants(rays)[good])
    if good.any(0).sum() < _MIN_DEPTHS or np.ptp(x) <= _EXACT:
        return 0.5, math.inf
    y = np.log(lengths[good])
    information = 1 / (depth_std**2 + (by_match[good] / lengths[good]) ** 2)
    slope = 0.5
    for _ in range(_STEPS):
        error = y - slope * x
        error -= np.median(error)
        width = max(EFFICIENT * DEVIATION * float(np.median(np.abs(error))), _EXACT)
        weights = information / (1 + (error / width) ** 2)
        moved = weights * (x - np.average(x, weights=weights))
        slope = float(moved @ y / (moved @ x))
    return slope, math.sqrt(_CORRELATED * np.square(moved * error).sum()) / float(moved @ x)


def _single_lengths(
    rays: Rays, z: np.ndarray, R: np.ndarray, t: np.ndarray
) -> tuple[np.ndarray, np.ndarray]:
    """The length of t (2, N) by each depth, and its deviation from the error of matches."""
    both = inverse_depths(*rays, R, t), inverse_depths(*rays[::-1], R.T, -R.T @ t)
    inverse, std = np.stack(both, axis=1)
    return inverse * z, std * z
