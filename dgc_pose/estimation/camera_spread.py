"""How far two cameras may be from their K: the focal lengths and principal points, as a Gaussian;
and the derivatives of Sampson errors by the pose and by these deviations.

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
from dgc_pose.estimation.problem import TwoViewProblem
from dgc_pose.geometry.epipolar import epipolar_terms, essential_from_pose, homogeneous, skew

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
_AS_NORMALISED = np.zeros(6)


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


def error_slopes(
    problem: TwoViewProblem,
    R: np.ndarray,
    t: np.ndarray,
    spread: CameraSpread = EXACT,
    deviations: np.ndarray = _AS_NORMALISED,
) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Signed Sampson errors (N,), their derivatives (N, 5 + M), and a basis (3, 2).

    The parameters are a rotation vector w, R becoming exp([w]x) R, two coordinates of t along the
    columns of the basis, which are perpendicular to t, and those of `spread`. deviations: (6,) of
    the cameras from those that normalised the problem; the errors are in the problem's unit.
    """
    if len(spread) and any(problem.lenses):
        return _lens_slopes(problem, R, t, spread, deviations)
    tangent = np.linalg.svd(t[None])[2][1:].T
    E = essential_from_pose(R, t)
    of_pose = [skew(t) @ skew(axis) @ R for axis in np.eye(3)]
    of_pose += [essential_from_pose(R, axis) for axis in tangent.T]
    F, changes = E, of_pose
    if len(spread):
        A1, A2 = normaliser(deviations[:3]), normaliser(deviations[3:])
        F, changes = A2.T @ E @ A1, [A2.T @ change @ A1 for change in of_pose]
        of_cameras = [A2.T @ E @ change for change in normaliser_slopes(deviations[:3])]
        of_cameras += [change.T @ E @ A1 for change in normaliser_slopes(deviations[3:])]
        changes += list(np.tensordot(spread.basis.T, of_cameras, axes=1))
    algebraic, squared1, squared2 = epipolar_terms(problem.points1, problem.points2, F)
    squared = np.maximum(squared1 + squared2, np.finfo(float).tiny)  # 0 at the epipoles
    # Points as columns, and all parameters at once: NumPy is slow along short axes.
    x1, x2 = homogeneous(problem.points1).T, homogeneous(problem.points2).T
    stacked = np.stack(changes)
    changed2, changed1 = stacked @ x1, stacked.transpose(0, 2, 1) @ x2  # (5 + M, 3, N)
    lengthening = ((F.T @ x2)[:2] * changed1[:, :2]).sum(1)
    lengthening += ((F @ x1)[:2] * changed2[:, :2]).sum(1)
    slopes = (x2 * changed2).sum(1) - algebraic / squared * lengthening
    root = np.sqrt(squared)
    return algebraic / root, (slopes / root).T, tangent


def _lens_slopes(
    problem: TwoViewProblem,
    R: np.ndarray,
    t: np.ndarray,
    spread: CameraSpread,
    deviations: np.ndarray,
) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """As `error_slopes`, of cameras with lenses: deviations move each point in another way."""
    sides = (
        (problem.points1, problem.lenses[0], deviations[:3]),
        (problem.points2, problem.lenses[1], deviations[3:]),
    )
    points1, points2 = (deviated(*side) for side in sides)
    moved = replace(problem, points1=points1, points2=points2)
    error, of_pose, tangent = error_slopes(moved, R, t)
    E = essential_from_pose(R, t)
    lines2, lines1 = (homogeneous(points1) @ E.T)[:, :2], (homogeneous(points2) @ E)[:, :2]
    squared = np.maximum((lines1**2).sum(1) + (lines2**2).sum(1), np.finfo(float).tiny)[:, None]
    root, over = np.sqrt(squared), error[:, None] / squared
    # By each point: of the algebraic error, and of the length of the line in the other image.
    by_point1 = lines1 / root - over * (lines2 @ E[:2, :2])
    by_point2 = lines2 / root - over * (lines1 @ E[:2, :2].T)
    by_side = [
        (by_point[:, None] @ deviated_slopes(*side))[:, 0]
        for by_point, side in zip((by_point1, by_point2), sides, strict=True)
    ]
    of_cameras = np.hstack(by_side)
    of_cameras[:, [0, 3]] += error[:, None] / 2  # of the growth
    slopes = np.hstack([of_pose, of_cameras @ spread.basis])
    growth = np.exp(deviations[[0, 3]].mean())
    return np.nan_to_num(error * growth), np.nan_to_num(slopes * growth), tangent
