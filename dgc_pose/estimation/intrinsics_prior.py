"""The Gaussian prior of how far the focal lengths, principal points and lenses of two cameras are
from their K and lens; and the derivatives of Sampson errors by the pose and by these parameters.

The parameters of one camera are k = ln(f / f of K); the shift (x, y) of its principal point over
the focal length of K; the changes (c, d) of its two radial coefficients (`geometry.radial`), which
are 0 for a pinhole; and the change a of ln(fy / fx).
"""

from __future__ import annotations

import math
from dataclasses import dataclass, replace

import numpy as np

from dgc_pose.cameras.camera import Camera
from dgc_pose.cameras.colmap_camera import RADIAL, Distortion
from dgc_pose.estimation.least_squares import prior_information
from dgc_pose.estimation.problem import TwoViewProblem
from dgc_pose.geometry.epipolar import essential_from_pose, homogeneous, skew, tangent_axes
from dgc_pose.geometry.radial import undistorted, undistorted_gradient, unprojected

_SLOPE_STEP = 1e-5  # of distorted points, for derivatives through a lens


@dataclass(frozen=True, eq=False)
class IntrinsicsPrior:
    """The prior of the parameters (k1, x1, y1, c1, d1, a1, k2, ..., a2) of two cameras: they are
    `basis` times a standard normal vector (M,)."""

    basis: np.ndarray  # (12, M); no columns: both cameras are exact

    @classmethod
    def of(cls, camera1: Camera, camera2: Camera) -> IntrinsicsPrior:
        """The prior with the standard deviations of two cameras. One camera that took both images,
        by its `identity`, has one focal length and one lens. It has one principal point unless the
        image sizes differ or an image may be a crop."""
        same = camera1.identity is not None and camera1.identity == camera2.identity
        one_centre = camera1.size == camera2.size and not any(map(may_be_crop, (camera1, camera2)))
        columns = []
        for axis, sides in enumerate(zip(*map(parameter_stds, (camera1, camera2)), strict=True)):
            column = np.zeros((2 * SIZE, 2))
            column[axis, 0], column[SIZE + axis, 1] = sides
            if same and (axis not in (1, 2) or one_centre):
                column = column.sum(axis=1, keepdims=True)
            columns.append(column)
        basis = np.hstack(columns)
        return cls(basis[:, basis.any(axis=0)])

    def __len__(self) -> int:
        return self.basis.shape[1]

    def covariance(self, normal: np.ndarray) -> np.ndarray:
        """The covariance (12, 12) of the parameters, from that of the normal vector, (M, M)."""
        covariance: np.ndarray = self.basis @ normal @ self.basis.T
        return covariance

    @property
    def information(self) -> np.ndarray:
        """(5 + M, 5 + M), of a pose and the normal vector; 0 for the pose."""
        return prior_information(5 + len(self), np.ones(len(self)))


SIZE = 6  # parameters of a camera
FOCALS = [0, SIZE]  # the rows of ln f
ASPECTS = [5, SIZE + 5]  # the rows of ln fy / fx
EXACT = IntrinsicsPrior(np.zeros((2 * SIZE, 0)))
_SEEN_AND_LENS = np.eye(2 + SIZE)[[0, 1, 5, 6]]  # x and y of a point, c and d
_AS_NORMALISED = np.zeros(2 * SIZE)
_PINHOLE = Distortion(RADIAL, (0.0, 0.0))  # as a lens
_OF_PART = 0.01  # least deviation of the principal point of a crop, over the longer side
_SECOND_LENS_STD = 2.0  # of d, over that of c; in telephones d is -2 to -4 times c


def expanded(covariance: np.ndarray, tangent: np.ndarray) -> np.ndarray:
    """The covariance (6, 6) of a rotation vector and t, from the covariance (5, 5) of the vector
    and the coordinates of t along the axes (3, 2)."""
    expand = np.zeros((6, 5))
    expand[:3, :3] = np.eye(3)
    expand[3:, 3:] = tangent
    return expand @ covariance @ expand.T


def may_be_crop(camera: Camera) -> bool:
    """Whether the image may be a crop, with a principal point of its own."""
    most = _OF_PART * max(camera.size or (0,))
    return camera.focal_source != "given" and camera.centre_std > most


def parameter_stds(camera: Camera) -> tuple[float, ...]:
    """The standard deviations (SIZE,) of a camera's parameters."""
    centre = camera.centre_std / camera.focal
    lens = camera.lens_std
    return camera.focal_std, centre, centre, lens, _SECOND_LENS_STD * lens, camera.aspect_std


def _shrinks(parameters: np.ndarray) -> np.ndarray:
    """The factors (2,) by which x and y of a point grow if a K with parameters normalises it."""
    k = parameters[0]
    a = parameters[5]
    return np.exp([a / 2 - k, -a / 2 - k])


def renormalised(points: np.ndarray, lens: Distortion | None, parameters: np.ndarray) -> np.ndarray:
    """Normalised points (N, 2), normalised anew by a camera with parameters (SIZE,); NaN where its
    distortion cannot be undone. lens: of the camera without these parameters."""
    lens = lens or _PINHOLE
    return _undone(_moved(points, lens, parameters), lens, parameters)


def renormalised_pair(
    problem: TwoViewProblem, parameters: np.ndarray
) -> tuple[np.ndarray, np.ndarray]:
    """The points (N, 2) of both images, normalised anew by cameras with parameters (2 * SIZE,)."""
    return (
        renormalised(problem.points1, problem.lenses[0], parameters[:SIZE]),
        renormalised(problem.points2, problem.lenses[1], parameters[SIZE:]),
    )


def renormalised_slopes(
    points: np.ndarray, lens: Distortion | None, parameters: np.ndarray, undone: np.ndarray
) -> np.ndarray:
    """The derivatives (N, 2, SIZE) of `renormalised` by the parameters. undone: its result."""
    axes = np.repeat(np.eye(2), len(points), axis=1)
    both = np.tile(points, (2, 1)), lens, parameters, np.tile(undone, (2, 1))
    slopes = by_parameters(*both, axes).T.reshape(2, len(points), SIZE)
    return slopes.transpose(1, 0, 2)


def by_parameters(
    points: np.ndarray,
    lens: Distortion | None,
    parameters: np.ndarray,
    undone: np.ndarray,
    gradient: np.ndarray,
) -> np.ndarray:
    """The derivatives (SIZE, N) by the parameters of a function of the renormalised points.

    points: normalised, (N, 2). undone: renormalised, (N, 2). gradient: of the function by these,
    (2, N).
    """
    lens = lens or _PINHOLE
    moved = _moved(points, lens, parameters)
    if lens.projection == "plane":
        by_seen, by_lens = undistorted_gradient(undone, lens.radial + parameters[3:5], gradient)
    else:
        by_seen, by_lens = _gradient_by_differences(moved, lens, parameters, gradient)
    by_logs = by_seen * moved.T
    by_focal = -by_logs.sum(0)
    by_centre = -by_seen * _shrinks(parameters)[:, None]
    by_aspect = (by_logs[0] - by_logs[1]) / 2
    return np.vstack([by_focal, by_centre, by_lens, by_aspect])


def _gradient_by_differences(
    moved: np.ndarray, lens: Distortion, parameters: np.ndarray, gradient: np.ndarray
) -> tuple[np.ndarray, np.ndarray]:
    """As `undistorted_gradient`, for any lens."""
    # The coefficients of a lens that pycolmap computes are no parameters.
    axes = _SEEN_AND_LENS[:2] if lens.projection is None else _SEEN_AND_LENS
    slopes = np.zeros((4, len(moved)))
    for row, axis in enumerate(_SLOPE_STEP * axes):
        ahead = _undone(moved + axis[:2], lens, parameters + axis[2:])
        behind = _undone(moved - axis[:2], lens, parameters - axis[2:])
        slopes[row] = (gradient * (ahead - behind).T).sum(0) / (2 * _SLOPE_STEP)
    return slopes[:2], slopes[2:]


def _moved(points: np.ndarray, lens: Distortion, parameters: np.ndarray) -> np.ndarray:
    """Normalised points (N, 2), distorted again by the lens, for the K of the parameters."""
    seen = points if lens is _PINHOLE else lens.apply(points)
    return (seen - parameters[1:3]) * _shrinks(parameters)


def _undone(moved: np.ndarray, lens: Distortion, parameters: np.ndarray) -> np.ndarray:
    if lens.projection is None:
        return lens.undo(moved)
    return unprojected(undistorted(moved, lens.radial + parameters[3:5]), lens.projection)


def with_parameters(camera: Camera, parameters: np.ndarray) -> Camera:
    """The camera changed by parameters (SIZE,); its standard deviations stay."""
    if not parameters.any():
        return camera
    lens = camera.distortion
    if parameters[3:5].any():
        lens = lens or _PINHOLE
        radial = (lens.radial + parameters[3:5]).tolist()
        lens = replace(lens, coefficients=(*radial, *lens.coefficients[2:]))
    K = camera.K.copy()
    K[0, 2] += parameters[1] * K[0, 0]
    K[1, 2] += parameters[2] * K[1, 1]
    K[:2, :2] /= _shrinks(parameters)[:, None]
    return replace(camera, K=K, distortion=lens)


def between(camera: Camera, other: Camera) -> np.ndarray:
    """The parameters (SIZE,) that change one camera into another with the same kind of lens; the
    inverse of `with_parameters`."""
    coefficients = [(c.distortion or _PINHOLE).radial for c in (camera, other)]
    lens = np.subtract(coefficients[1], coefficients[0])
    (fx, fy), (other_fx, other_fy) = (c.K.diagonal()[:2].tolist() for c in (camera, other))
    shift = (other.K[:2, 2] - camera.K[:2, 2]) / [fx, fy]
    focal = math.log(other_fx / fx * other_fy / fy) / 2
    aspect = math.log(other_fy / fy / (other_fx / fx))
    return np.array([focal, *shift, *lens, aspect])


def have_same_lens(camera: Camera, other: Camera) -> bool:
    """Whether the lenses of two cameras differ in radial coefficients at most."""
    lens = camera.distortion or _PINHOLE
    others = other.distortion or _PINHOLE
    if lens.projection is None or others.projection is None:
        return lens == others
    return lens.projection == others.projection


def pair_with_parameters(
    cameras: tuple[Camera, Camera], parameters: np.ndarray
) -> tuple[Camera, Camera]:
    """Two cameras changed by parameters (2 * SIZE,)."""
    first, second = cameras
    return with_parameters(first, parameters[:SIZE]), with_parameters(second, parameters[SIZE:])


def error_slopes(
    problem: TwoViewProblem,
    R: np.ndarray,
    t: np.ndarray,
    prior: IntrinsicsPrior = EXACT,
    parameters: np.ndarray = _AS_NORMALISED,
) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Signed Sampson errors (N,), their derivatives (N, 5 + M), and a basis (3, 2).

    The derivatives are by a rotation vector w, which changes R to exp([w]x) R; by two coordinates
    of t along the columns of the basis, which are perpendicular to t; and by the normal vector of
    `prior`. parameters: (12,), how far the cameras are from those that normalised the problem. The
    errors are in the problem's unit; infinite, with slopes of 0, where a distortion cannot be
    undone.
    """
    points1 = problem.points1
    points2 = problem.points2
    if parameters.any():
        points1, points2 = renormalised_pair(problem, parameters)
    tangent = tangent_axes(t)
    E = essential_from_pose(R, t)
    changes = [skew(t) @ skew(axis) @ R for axis in np.eye(3)]
    changes += [essential_from_pose(R, axis) for axis in tangent.T]
    # Points as columns, and all parameters at once: NumPy is slow along short axes.
    x1 = homogeneous(points1).T
    x2 = homogeneous(points2).T
    lines2 = E @ x1
    lines1 = E.T @ x2
    squared = (lines1[:2] ** 2).sum(0) + (lines2[:2] ** 2).sum(0)
    squared = np.maximum(squared, np.finfo(float).tiny)  # 0 at the epipoles
    root = np.sqrt(squared)
    algebraic = (x2 * lines2).sum(0)
    stacked = np.stack(changes)
    changed2 = stacked @ x1  # (5, 3, N)
    changed1 = stacked.transpose(0, 2, 1) @ x2
    lengthening = (lines1[:2] * changed1[:, :2]).sum(1) + (lines2[:2] * changed2[:, :2]).sum(1)
    slopes = (((x2 * changed2).sum(1) - algebraic / squared * lengthening) / root).T
    error = algebraic / root
    if not len(prior):
        return error, slopes, tangent
    # Derivatives by each point of the algebraic error and of the other image's line's length.
    over = error / squared
    by_point1 = lines1[:2] / root - over * (E[:2, :2].T @ lines2[:2])
    by_point2 = lines2[:2] / root - over * (E[:2, :2] @ lines1[:2])
    lens1, lens2 = problem.lenses
    by_cameras = np.vstack(
        [
            by_parameters(problem.points1, lens1, parameters[:SIZE], points1, by_point1),
            by_parameters(problem.points2, lens2, parameters[SIZE:], points2, by_point2),
        ]
    )
    by_cameras[FOCALS] += error / 2  # derivative of the growth
    slopes = np.hstack([slopes, by_cameras.T @ prior.basis])
    growth = np.exp(parameters[FOCALS].mean())
    return np.nan_to_num(error * growth, nan=np.inf), np.nan_to_num(slopes * growth), tangent
