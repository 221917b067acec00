"""The derivatives of Sampson errors by a pose and by the deviations of its cameras."""

import numpy as np

from dgc_pose.estimation.camera_spread import EXACT, CameraSpread, normaliser, normaliser_slopes
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
    tangent = np.linalg.svd(t[None])[2][1:].T
    E = essential_from_pose(R, t)
    A1, A2 = normaliser(deviations[:3]), normaliser(deviations[3:])
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
    x1, x2 = homogeneous(problem.points1), homogeneous(problem.points2)
    lines2, lines1 = x1 @ F.T, x2 @ F
    slopes = np.empty((len(x1), len(changes)))
    for column, change in enumerate(changes):
        changed2, changed1 = x1 @ change.T, x2 @ change
        lengthening = (lines1 * changed1)[:, :2].sum(1) + (lines2 * changed2)[:, :2].sum(1)
        slopes[:, column] = (x2 * changed2).sum(1) - algebraic / squared * lengthening
    root = np.sqrt(squared)
    return algebraic / root, slopes / root[:, None], tangent
