"""The derivatives of Sampson errors by a pose and by the deviations of its cameras."""

from dataclasses import replace

import numpy as np

from dgc_pose.estimation.camera_spread import (
    EXACT,
    CameraSpread,
    deviated,
    deviated_slopes,
    normaliser,
    normaliser_slopes,
)
from dgc_pose.estimation.problem import TwoViewProblem
from dgc_pose.geometry.epipolar import epipolar_terms, essential_from_pose, homogeneous, skew

_AS_NORMALISED = np.zeros(6)


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
    sides = list(
        zip(
            (problem.points1, problem.points2),
            problem.lenses,
            (deviations[:3], deviations[3:]),
            strict=True,
        )
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
