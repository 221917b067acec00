"""The square whose corners several images show."""

import numpy as np

from dgc_pose.geometry.rotation import aligning_rotation, rotation_of_vector

_CORNERS = np.array([[-1, 1, 0], [1, 1, 0], [1, -1, 0], [-1, -1, 0]]) / 2  # in their order
_STEPS, _DELTA = 10, 1e-6  # of Gauss-Newton, and of its numeric derivatives


def fitted_square(
    points: np.ndarray, poses: np.ndarray, focals: np.ndarray, least_error: float
) -> tuple[float, float, np.ndarray]:
    """The side of a square of least reprojection error, its relative standard deviation, and the
    errors (V,) of the images: root mean squares in pixels. Infinite if no square is found.

    points: its corners in each image, in one order, normalised (V, 4, 2). poses: cam_from_world
    (V, 3, 4). focals: (V,) pixels. least_error: that a corner has at least, pixels.
    """
    rows = points[..., None] * poses[:, None, 2:] - poses[:, None, :2]  # (V, 4, 2, 4)
    corners = np.array([np.linalg.svd(of.reshape(-1, 4))[2][-1] for of in rows.swapaxes(0, 1)])
    with np.errstate(all="ignore"):
        corners = corners[:, :3] / corners[:, 3:]
        middle = corners.mean(0)
        side = np.linalg.norm(corners - np.roll(corners, 1, axis=0), axis=1).mean()

        def errors(p: np.ndarray) -> np.ndarray:
            R = rotation_of_vector(p[3:6]) @ axes
            at = middle + side * (p[:3] + np.exp(p[6]) * _CORNERS @ R.T)
            seen = np.einsum("vij,nj->vni", poses[:, :, :3], at) + poses[:, None, :, 3]
            off = (seen[..., :2] / seen[..., 2:] - points) * focals[:, None, None]
            return np.where(seen[..., 2:] > 0, off, np.inf).ravel()

        try:
            axes = aligning_rotation(_CORNERS, (corners - middle) / side)
            fit = np.zeros(7)
            for _ in range(_STEPS):
                off = errors(fit)
                slopes = np.stack([errors(fit + d) - off for d in _DELTA * np.eye(7)], 1) / _DELTA
                inverse = np.linalg.inv(slopes.T @ slopes)
                fit = fit - inverse @ slopes.T @ off
            off = errors(fit)
        except (np.linalg.LinAlgError, ValueError):
            return np.inf, np.inf, np.full(len(points), np.inf)
    each = np.sqrt((off**2).reshape(len(points), -1).mean(1) * 2)
    variance = max(float((off**2).sum()) / (off.size - 7), least_error**2)
    return float(side * np.exp(fit[6])), float(np.sqrt(variance * inverse[6, 6])), each
