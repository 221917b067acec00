"""Lenses of two radial coefficients c1 and c2: a point q is seen at q (1 + c1 |q|^2 + c2 |q|^4).

For COLMAP's RADIAL, q is the normalised point. For its OPENCV_FISHEYE, with other coefficients 0,
|q| is the angle to the optical axis. For a cylinder, x of q is the angle about its axis, and y the
height on it.
"""

from typing import Literal

import numpy as np
from numpy.typing import ArrayLike

Projection = Literal["plane", "angles", "cylinder"]
# Four steps are enough within the view of a photograph; the error is the square of the last one.
_NEWTON_STEPS = 20
_CONVERGED = 1e-7


def distorted(points: np.ndarray, coefficients: ArrayLike) -> np.ndarray:
    """Normalised points (N, 2) as the lens shows them. coefficients: (2,)."""
    growth, _ = _growth((points**2).sum(1), coefficients)
    return points * growth[:, None]


def undistorted(points: np.ndarray, coefficients: ArrayLike) -> np.ndarray:
    """The inverse of `distorted`; NaN beyond the radius at which `distorted` stops growing."""
    if not np.any(coefficients):
        return points
    seen = np.hypot(*points.T)
    radius = seen
    with np.errstate(all="ignore"):  # beyond the inverse
        for _ in range(_NEWTON_STEPS):
            across, along = _growth(radius**2, coefficients)
            step = (radius * across - seen) / along
            radius = radius - step
            if not (np.abs(step) > _CONVERGED).any():
                break
        across, along = _growth(radius**2, coefficients)
        known = (np.abs(step) < 1e-6) & (along > 0) & (across > 0)
        return np.where(known[:, None], points / across[:, None], np.nan)


def undistorted_gradient(
    undone: np.ndarray, coefficients: ArrayLike, gradient: np.ndarray
) -> tuple[np.ndarray, np.ndarray]:
    """The gradients by the distorted points (2, N) and by the coefficients (2, N) of a function of
    `undistorted`. undone: the result (N, 2) of `undistorted`. gradient: of the function by the
    undistorted points, (2, N)."""
    squared = (undone**2).sum(1)
    across, along = _growth(squared, coefficients)
    radial = (gradient * undone.T).sum(0)  # times the radius
    by_coefficient = -radial / along
    turned = radial / np.maximum(squared, 1e-300) * (1 / along - 1 / across)
    by_seen = gradient / across + undone.T * turned
    return by_seen, np.stack([by_coefficient * squared, by_coefficient * squared**2])


def _growth(squared: np.ndarray, coefficients: ArrayLike) -> tuple[np.ndarray, np.ndarray]:
    """The factors by which the lens stretches, across the radius and along it, at squared radii
    (N,)."""
    first, second = np.asarray(coefficients, np.float64)
    return (
        1 + squared * (first + second * squared),
        1 + squared * (3 * first + 5 * second * squared),
    )


def projected(points: np.ndarray, projection: Projection) -> np.ndarray:
    """The q (N, 2) of normalised points (N, 2), x / z and y / z."""
    if projection == "angles":
        radius = np.linalg.norm(points, axis=1, keepdims=True)
        return points * np.arctan(radius) / np.maximum(radius, 1e-300)
    if projection == "cylinder":
        x, y = points.T
        return np.column_stack([np.arctan(x), y / np.hypot(1, x)])
    return points


def unprojected(points: np.ndarray, projection: Projection) -> np.ndarray:
    """The inverse of `projected`; NaN at 90 degrees from the axis and beyond."""
    if projection == "plane":
        return points
    angle = np.linalg.norm(points, axis=1) if projection == "angles" else np.abs(points[:, 0])
    angle = np.where(angle < np.pi / 2, angle, np.nan)
    if projection == "angles":
        return points * (np.tan(angle) / np.maximum(angle, 1e-300))[:, None]
    x, y = points.T
    return np.column_stack([np.sign(x) * np.tan(angle), y / np.cos(angle)])
