"""How far two cameras may be from their K: the focal lengths and principal points, as a Gaussian.

The deviations of one camera are k = ln(f / f of K) and the shift (x, y) of its principal point over
the focal length of K. Points that K normalised are normalised by A of `normaliser` to what the
camera makes of them, so that F = A2^T E A1.
"""

from __future__ import annotations

import math
from dataclasses import dataclass, replace

import numpy as np

from dgc_pose.cameras.camera import Camera
from dgc_pose.cameras.colmap_camera import Distortion

_BY_LOG_FOCAL = np.diag([-1.0, -1.0, 0.0])  # derivative of A by k, times A^-1
_SLOPE_STEP = 1e-5  # of distorted points, for derivatives through a lens


@dataclass(frozen=True, eq=False)
class CameraSpread:
    """The deviations (k1, x1, y1, k2, x2, y2) of two cameras are `basis` times a standard normal
    vector (M,)."""

    basis: np.ndarray  # (6, M); no columns: both K are exact

    @classmethod
    def of(cls, camera1: Camera, camera2: Camera) -> CameraSpread:
        """The spread of two cameras' standard deviations. One camera that took both images, by its
        `identity`, has one focal length, and one principal point unless the images' sizes differ.
        """
        same = camera1.identity is not None and camera1.identity == camera2.identity
        columns = []
        for axis in range(3):
            sides = [
                camera.focal_std if axis == 0 else camera.centre_std / camera.focal
                for camera in (camera1, camera2)
            ]
            column = np.zeros((6, 2))
            column[axis, 0], column[3 + axis, 1] = sides
            if same and (axis == 0 or camera1.size == camera2.size):
                column = column.sum(axis=1, keepdims=True)
            columns.append(column)
        basis = np.hstack(columns)
        return cls(basis[:, basis.any(axis=0)])

    def __len__(self) -> int:
        return self.basis.shape[1]

    @property
    def shared_focal(self) -> bool:
        """Whether both cameras are off by the same factor."""
        focal = self.basis[[0, 3]]
        return bool((focal[0] == focal[1]).all() and focal.any())


EXACT = CameraSpread(np.zeros((6, 0)))


def normaliser(deviations: np.ndarray) -> np.ndarray:
    """A (3, 3) of the deviations (3,) of a camera."""
    shrink = math.exp(-deviations[0])
    x, y = deviations[1:]
    return np.array([[shrink, 0, -x * shrink], [0, shrink, -y * shrink], [0, 0, 1]])


def normaliser_slopes(deviations: np.ndarray) -> list[np.ndarray]:
    """The derivatives (3, 3) of A by the three deviations (3,)."""
    A = normaliser(deviations)
    by_x, by_y = np.zeros((3, 3)), np.zeros((3, 3))
    by_x[0, 2] = by_y[1, 2] = -A[0, 0]
    return [_BY_LOG_FOCAL @ A, by_x, by_y]


def deviated(points: np.ndarray, lens: Distortion | None, deviations: np.ndarray) -> np.ndarray:
    """Normalised points (N, 2) as a camera with deviations (3,) from its K normalises
    them; NaN where its distortion cannot be undone."""
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
        ahead, behind = (
            [lens.undo(moved + s * a) for a in np.eye(2)] for s in (_SLOPE_STEP, -_SLOPE_STEP)
        )
        by_seen = (np.stack(ahead, axis=-1) - np.stack(behind, axis=-1)) / (2 * _SLOPE_STEP)
    return np.concatenate([-by_seen @ moved[:, :, None], -shrink * by_seen], axis=2)


def deviating(camera: Camera, deviations: np.ndarray) -> Camera:
    """The camera with deviations (3,) from its K; its standard deviations stay."""
    if not deviations.any():
        return camera
    K = camera.K.copy()
    K[0, 2] += deviations[1] * K[0, 0]
    K[1, 2] += deviations[2] * K[1, 1]
    K[:2, :2] *= math.exp(deviations[0])
    return replace(camera, K=K)
