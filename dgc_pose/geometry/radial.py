"""Lenses of two radial coefficients c1 and c2: a point q is seen at q (1 + c1 |q|^2 + c2 |q|^4).

For COLMAP's RADIAL, q is the normalised point. For its OPENCV_FISHEYE, with other coefficients 0,
|q| is the angle to the optical axis. For a cylinder, x of q is the angle about its axis, and y the
height on it.
"""

from typing import Literal

import numpy as np
from numpy.typing import ArrayLike

Projection = Literal["plane", "angles", "cylinder"]
_NEWTON_STEPS, _CONVERGED = 20, 1e-12  # five are enough within the view of a photograph


def distorted(points: np.ndarray, coefficients: ArrayLike) -> np.ndarray:
    """Normalised points (N, 2) as the lens shows them. coefficients: (2,)."""
    growth, _ = _growth((points**2).sum(1), coefficients)
    return points * growth[:, None]


def undistorted(points: np.ndarray, coefficients: ArrayLike) -> np.ndarray:
    """The inverse of `distorted`; NaN beyond the radius at which `distorted` stops growing."""
    if not np.any(coefficients):
        return points
    seen = np.linalg.norm(points, axis=1)
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


def undistorted_slopes(
    undone: np.ndarray, coefficients: ArrayLike
) -> tuple[np.ndarray, np.ndarray]:
    """The derivatives of `undistorted` by the distorted points (N, 2, 2) and by the coefficients
    (N, 2, 2). undone: the result (N, 2) of `undistorted`."""
    squared = (undone**2).sum(1)
    across, along = _growth(squared, coefficients)
    outer = undone[:, :, None] * undone[:, None] / np.maximum(squared, 1e-300)[:, None, None]
    by_seen = (np.eye(2) - outer) / across[:, None, None] + outer / along[:, None, None]
    powers = np.stack([squared, squared**2], axis=1)
    return by_seen, -undone[:, :, None] * (powers / along[:, None])[:, None]


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
