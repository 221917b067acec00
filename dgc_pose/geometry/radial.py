"""A lens of two radial coefficients c1 and c2, COLMAP's RADIAL: a normalised point u is seen at
u (1 + c1 |u|^2 + c2 |u|^4)."""

import numpy as np
from numpy.typing import ArrayLike

_NEWTON_STEPS, _CONVERGED = 20, 1e-12  # five are enough within the view of a photograph


def distorted(points: np.ndarray, coefficients: ArrayLike) -> np.ndarray:
    """Normalised points (N, 2) as the lens shows them. coefficients: (2,)."""
    growth, _ = _growth((points**2).sum(1), coefficients)
    return points * growth[:, None]


def undistorted(points: np.ndarray, coefficients: ArrayLike) -> np.ndarray:
    """The inverse of `distorted`; NaN beyond the radius at which that stops growing."""
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
    """The derivatives of `undistorted` by the seen points (N, 2, 2) and by the coefficients
    (N, 2, 2), at the points `undone` (N, 2) that it gives."""
    squared = (undone**2).sum(1)
    across, along = _growth(squared, coefficients)
    outer = undone[:, :, None] * undone[:, None] / np.maximum(squared, 1e-300)[:, None, None]
    by_seen = (np.eye(2) - outer) / across[:, None, None] + outer / along[:, None, None]
    powers = np.stack([squared, squared**2], axis=1)
    return by_seen, -undone[:, :, None] * (powers / along[:, None])[:, None]


def _growth(squared: np.ndarray, coefficients: ArrayLike) -> tuple[np.ndarray, np.ndarray]:
    """What the lens lengthens by, across the radius and along it, at squared radii (N,)."""
    first, second = np.asarray(coefficients, np.float64)
    return (
        1 + squared * (first + second * squared),
        1 + squared * (3 * first + 5 * second * squared),
    )
