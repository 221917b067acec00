"""What the deviations of a camera's K make of points whose lens distortion is undone."""

import math

import numpy as np

from dgc_pose.cameras.colmap_camera import Distortion

_STEP = 1e-5  # of the distorted points, for the derivatives


def deviated(points: np.ndarray, lens: Distortion | None, deviations: np.ndarray) -> np.ndarray:
    """Normalised points (N, 2) as a camera with deviations (3,) from its K normalises them, see
    `CameraSpread`; NaN where its distortion cannot be undone."""
    if lens is None:
        return (points - deviations[1:]) * math.exp(-deviations[0])
    seen = (lens.apply(points) - deviations[1:]) * math.exp(-deviations[0])
    return lens.undo(seen)


def deviated_slopes(
    points: np.ndarray, lens: Distortion | None, deviations: np.ndarray
) -> np.ndarray:
    """The derivatives (N, 2, 3) of `deviated` by the deviations."""
    seen = points if lens is None else lens.apply(points)
    shrink = math.exp(-deviations[0])
    moved = (seen - deviations[1:]) * shrink
    by_seen = np.broadcast_to(np.eye(2), (len(points), 2, 2))
    if lens is not None:
        ahead, behind = ([lens.undo(moved + s * a) for a in np.eye(2)] for s in (_STEP, -_STEP))
        by_seen = (np.stack(ahead, axis=-1) - np.stack(behind, axis=-1)) / (2 * _STEP)
    return np.concatenate([-by_seen @ moved[:, :, None], -shrink * by_seen], axis=2)
