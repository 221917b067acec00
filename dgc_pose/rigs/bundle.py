"""Bundle adjustment of pictures with a prior of their cameras (Triggs et al. 2000), and its
covariance.

COLMAP's adjustment knows no prior of a focal length or a lens, and takes all errors as independent.
Here its prior and the matches determine a camera together. The residuals are those of a location:
reprojection errors of points, and Sampson errors of matches. The points are eliminated.
"""

from __future__ import annotations

import math
from collections.abc import Iterator, Sequence
from dataclasses import dataclass, replace
from functools import cached_property

import cv2
import numpy as np

from dgc_pose.cameras.colmap_camera import Distortion
from dgc_pose.estimation.intrinsics_prior import (
    EXACT,
    FOCALS,
    SIZE,
    IntrinsicsPrior,
    error_slopes,
    renormalised_pair,
)
from dgc_pose.estimation.least_squares import (
    Slopes,
    block_sums,
    cauchy_slopes,
    cauchy_weights,
    loss_width,
    minimised,
    prior_information,
)
from dgc_pose.estimation.problem import TwoViewProblem
from dgc_pose.geometry.epipolar import depths
from dgc_pose.localization.correspondences import PointCorrespondences, WorldPose, pose_slopes
from dgc_pose.localization.fit import even_sample
from dgc_pose.system.parallel import one_blas_thread

_POSE = 6  # parameters: a rotation vector and the centre
_ROUNDS = 2  # selections of the inliers
_STEPS = 12  # after each selection
_MIN_INLIERS = 8  # of a picture or of a pair
_FITTED = 200  # matches of a pair; the errors of neighbours are correlated
_LEAST_INFORMATION = 1e-9  # of a point, over the mean: two lines of sight may be one
_FIXED = 1e11  # information that fixes the frame
_LEAST_OF_POSE = 1e-6  # information: a picture that nothing places stays where it is


@dataclass(frozen=True, eq=False)
class Observed:
    """The points that a picture shows, each once."""

    image: int
    points: np.ndarray  # (n,) int
    seen: np.ndarray  # (n, 2), normalised by the start of its camera
    threshold: float  # largest error of an inlier, normalised
    width: float = 0.0  # of the Cauchy loss, normalised


@dataclass(frozen=True, eq=False)
class Matched:
    """The matches of two pictures."""

    images: tuple[int, int]
    problem: TwoViewProblem  # normalised by the starts of their cameras
    width: float = 0.0  # of the Cauchy loss, in the problem's unit


@dataclass(frozen=True, eq=False)
class BundleCamera:
    """A camera: its lens at the start, its prior, and how far it is from the start, as (SIZE,)
    parameters of `IntrinsicsPrior`."""

    lens: Distortion | None
    basis: np.ndarray  # (SIZE, M) of the prior; no columns: the camera is exact
    expected: np.ndarray  # (SIZE,) by the prior
    parameters: np.ndarray  # (SIZE,)

    def moved(self, step: np.ndarray) -> BundleCamera:
        """After a step (M,)."""
        return replace(self, parameters=self.parameters + self.basis @ step)

    @property
    def deviation(self) -> np.ndarray:
        """From the prior, (M,), in its standard deviations."""
        off = self.parameters - self.expected
        normalised: np.ndarray = np.linalg.lstsq(self.basis, off, rcond=None)[0]
        return normalised


@dataclass(frozen=True, eq=False)
class Bundle:
    """N pictures with their cameras, P points, and what the pictures show of them."""

    cameras: Sequence[BundleCamera]
    camera_of: Sequence[int]  # (N,)
    R: np.ndarray  # (N, 3, 3) cam_from_world
    centres: np.ndarray  # (N, 3) world
    points: np.ndarray  # (P, 3) world
    observed: Sequence[Observed]
    matched: Sequence[Matched]
    fixing: Sequence[int]  # the pictures whose mean pose is the frame

    @cached_property
    def columns(self) -> Sequence[range]:
        """The columns of each picture's pose, then those of each camera."""
        sizes = [_POSE] * len(self.R) + [camera.basis.shape[1] for camera in self.cameras]
        ends = np.cumsum([0, *sizes]).tolist()
        return [range(*bounds) for bounds in zip(ends, ends[1:], strict=False)]

    def camera_columns(self, image: int) -> range:
        """The columns of the camera of a picture."""
        return self.columns[len(self.R) + self.camera_of[image]]

    def pose(self, image: int) -> WorldPose:
        """The pose and camera of a picture."""
        camera = self.cameras[self.camera_of[image]]
        return WorldPose(self.R[image], self.centres[image], camera.parameters)

    def moved(self, step: np.ndarray, points: np.ndarray) -> Bundle:
        """After a step (K,) along the columns, with other points."""
        steps = step[: _POSE * len(self.R)].reshape(-1, _POSE)
        turns = np.stack([cv2.Rodrigues(turn)[0] for turn in steps[:, :3]])
        own = self.columns[len(self.R) :]
        moved = [
            camera.moved(step[columns]) for camera, columns in zip(self.cameras, own, strict=True)
        ]
        centres = self.centres + steps[:, 3:]
        return replace(self, R=turns @ self.R, centres=centres, points=points, cameras=moved)

    def with_inliers(self, whole: Bundle) -> Bundle:
        """With the inliers among the observations and matches of `whole`, and the widths of their
        losses. A point that one picture alone shows is left out."""
        observed = []
        for part in whole.observed:
            error, in_front = self.shown(part).errors(self.pose(part.image))
            good = in_front & (error < part.threshold)
            if good.sum() >= _MIN_INLIERS:
                width = loss_width(error[good], part.threshold)
                seen = part.seen[good]
                observed.append(replace(part, points=part.points[good], seen=seen, width=width))
        every = [part.points for part in observed]
        count = np.bincount(np.concatenate([*every, np.zeros(0, int)]), minlength=len(self.points))
        shared = [(part, count[part.points] > 1) for part in observed]
        return replace(
            self,
            observed=[
                replace(part, points=part.points[several], seen=part.seen[several])
                for part, several in shared
                if several.sum() >= _MIN_INLIERS
            ],
            matched=[found for part in whole.matched if (found := self._inliers(part))],
        )

    def shown(self, part: Observed) -> PointCorrespondences:
        """The points of an observation."""
        lens = self.cameras[self.camera_of[part.image]].lens
        return PointCorrespondences(self.points[part.points], part.seen, lens, part.threshold)

    def pair(self, part: Matched) -> tuple[np.ndarray, np.ndarray, float, np.ndarray]:
        """R (3, 3) and unit t (3,) of the second picture from the first, the distance between them,
        and the parameters (2 * SIZE,) of both cameras."""
        first, second = part.images
        t = self.R[second] @ (self.centres[first] - self.centres[second])
        length = max(float(np.linalg.norm(t)), 1e-12)
        each = [self.pose(image).parameters for image in part.images]
        return self.R[second] @ self.R[first].T, t / length, length, np.concatenate(each)

    def _inliers(self, part: Matched) -> Matched | None:
        R, t, _, parameters = self.pair(part)
        threshold = part.problem.threshold
        growth = math.exp(parameters[FOCALS].mean())  # as of the errors that are minimised
        error = growth * np.abs(error_slopes(part.problem, R, t, EXACT, parameters)[0])
        depth1, depth2 = depths(*renormalised_pair(part.problem, parameters), R, t)
        good = np.flatnonzero((error < threshold) & (depth1 > 0) & (depth2 > 0))
        if len(good) < _MIN_INLIERS:
            return None
        chosen = part.problem.subset(good[even_sample(len(good), _FITTED)])
        return replace(part, problem=chosen, width=loss_width(error[good], threshold))


@dataclass(frozen=True, eq=False)
class _Rows:
    """n errors with their derivatives by k parameters, and by points."""

    image: int
    seen: np.ndarray  # (n, 2) where in the picture
    error: np.ndarray  # (n,)
    columns: np.ndarray  # (k,)
    slopes: np.ndarray  # (n, k)
    width: float  # of the loss
    points: np.ndarray  # (n / 2,) int, for the errors along x, then along y; (0,) without points
    by_point: np.ndarray  # (n, 3)

    @cached_property
    def weights(self) -> np.ndarray:
        """(n,) by which the squares have the slope of the Cauchy loss."""
        return cauchy_weights(self.error, self.width)


def _rows(bundle: Bundle) -> Iterator[_Rows]:
    for part in bundle.observed:
        own = bundle.camera_columns(part.image)
        basis = bundle.cameras[bundle.camera_of[part.image]].basis
        prior = IntrinsicsPrior(np.vstack([np.zeros_like(basis), basis]))
        error, slopes = bundle.shown(part).slopes(bundle.pose(part.image), prior)
        columns = np.array([*bundle.columns[part.image], *own])
        by_point = -slopes[:, 3:_POSE]  # an error depends on the point minus the centre
        seen = np.tile(part.seen, (2, 1))
        yield _Rows(part.image, seen, error, columns, slopes, part.width, part.points, by_point)
    for pair in bundle.matched:
        yield _rows_of_pair(bundle, pair)


def _rows_of_pair(bundle: Bundle, part: Matched) -> _Rows:
    first, second = part.images
    bases = [bundle.cameras[bundle.camera_of[image]].basis for image in part.images]
    both = np.zeros((2 * SIZE, sum(basis.shape[1] for basis in bases)))
    both[:SIZE, : bases[0].shape[1]] = bases[0]
    both[SIZE:, bases[0].shape[1] :] = bases[1]
    R, t, length, parameters = bundle.pair(part)
    error, slopes, tangent = error_slopes(part.problem, R, t, IntrinsicsPrior(both), parameters)
    by_second = pose_slopes(slopes, tangent, t, bundle.R[second], length)
    # The pair depends on the difference of the centres.
    parts = [-slopes[:, :3] @ R, -by_second[:, 3:], by_second, slopes[:, 5:]]
    columns = [*bundle.columns[first], *bundle.columns[second]]
    columns += [*bundle.camera_columns(first), *bundle.camera_columns(second)]
    seen = part.problem.points2
    none = np.zeros(0, int)
    return _Rows(
        second, seen, error, np.array(columns), np.hstack(parts), part.width, none, np.zeros((0, 3))
    )


class NormalEquations:
    """The normal equations of a bundle, without the points.

    Attributes:
        bundle: Where they are.
        slopes: The Cauchy losses and the priors, by the columns (K,) of the bundle.
    """

    def __init__(self, bundle: Bundle) -> None:
        self.bundle = bundle
        count = bundle.columns[-1].stop
        cost = 0.0
        whole = np.zeros((count, count))
        gradient = np.zeros(count)
        by_points = np.zeros((len(bundle.points), 3, 3))
        self._point_gradient = np.zeros((len(bundle.points), 3))
        crosses = list[tuple[np.ndarray, np.ndarray, np.ndarray]]()
        for rows in _rows(bundle):
            own = cauchy_slopes(rows.error, rows.slopes, rows.width)
            cost += own.cost
            # A picture pair of one camera has each of its columns twice.
            np.add.at(whole, np.ix_(rows.columns, rows.columns), own.hessian)
            np.add.at(gradient, rows.columns, own.gradient)
            if len(rows.points):
                by_point = rows.by_point.reshape(2, -1, 3)
                heavy = (rows.by_point * rows.weights[:, None]).reshape(2, -1, 3)
                errors = rows.error.reshape(2, -1, 1)
                by_points[rows.points] += np.einsum("xni,xnj->nij", heavy, by_point)
                self._point_gradient[rows.points] += (heavy * errors).sum(0)
                cross = np.einsum("xni,xnk->nik", heavy, rows.slopes.reshape(2, len(heavy[0]), -1))
                crosses.append((rows.columns, rows.points, cross))
        poses = np.arange(_POSE * len(bundle.R))
        whole[poses, poses] += _LEAST_OF_POSE
        least = _LEAST_INFORMATION * np.trace(by_points, axis1=1, axis2=2).mean()
        self._inverse = np.linalg.inv(by_points + max(least, 1e-300) * np.eye(3))
        self._cross = np.zeros((len(bundle.points), 3, count))
        axes = np.arange(3)[:, None]
        for open_columns, points, cross in crosses:
            self._cross[points[:, None, None], axes, open_columns] += cross
        # A picture shows few of the points, and those that it does not show change nothing.
        for open_columns, points, cross in crosses:
            reducing = (self._inverse[points] @ cross).reshape(-1, len(open_columns)).T
            whole[open_columns] -= reducing @ self._cross[points].reshape(-1, count)
            gradient[open_columns] -= reducing @ self._point_gradient[points].ravel()
        deviations = np.concatenate([camera.deviation for camera in bundle.cameras])
        self.slopes = Slopes(cost, whole, gradient).with_prior(deviations)

    def moved(self, step: np.ndarray) -> NormalEquations:
        """After a step (K,), with the points that fit it."""
        along = self._point_gradient + self._cross @ step
        shift = np.einsum("nij,nj->ni", self._inverse, along)
        return NormalEquations(self.bundle.moved(step, self.bundle.points - shift))

    @one_blas_thread()
    def covariance(self) -> np.ndarray:
        """The covariance (K, K) of all columns, in the frame of the mean pose of the pictures
        `fixing`.

        As for a pose, see `estimation.covariance`: the usual covariance, in which `CORRELATED`
        matches count as one, and the scatter of the gradients of the blocks of each picture, whose
        errors are correlated.
        """
        frame = self._frame()
        inverse = np.linalg.inv(self.slopes.hessian + _FIXED * frame.T @ frame)
        scatter = np.zeros_like(inverse)
        images: dict[int, list[tuple[np.ndarray, np.ndarray]]] = {}
        for rows in _rows(self.bundle):
            weighted = rows.weights * rows.error
            gradients = np.zeros((len(weighted), len(inverse)))
            np.add.at(gradients.T, rows.columns, (rows.slopes * weighted[:, None]).T)
            if len(rows.points):
                both = np.tile(rows.points, 2)
                inverses = self._inverse[both]
                shifts = np.einsum("n,nij,nj->ni", weighted, inverses, rows.by_point)
                gradients -= np.einsum("ni,nik->nk", shifts, self._cross[both])
            images.setdefault(rows.image, []).append((rows.seen, gradients))
        for parts in images.values():
            seen, gradients = (np.vstack(each) for each in zip(*parts, strict=True))
            sums = block_sums(gradients, seen, (0.0, 0.0))
            scatter += sums.T @ sums
        open_ = np.ones(len(inverse) - _POSE * len(self.bundle.R))
        prior = prior_information(len(inverse), open_)
        covariance: np.ndarray = inverse + inverse @ (scatter + prior) @ inverse
        return covariance

    def _frame(self) -> np.ndarray:
        """(7, K): the mean turn, shift and growth of the pictures `fixing` that points place."""
        bundle = self.bundle
        placed = {part.image for part in bundle.observed}
        fixing = [image for image in bundle.fixing if image in placed] or [*bundle.fixing]
        rows = np.zeros((7, bundle.columns[-1].stop))
        offsets = bundle.centres - bundle.centres[fixing].mean(0)
        extent = float(np.linalg.norm(offsets[fixing], axis=1).max()) or 1.0
        for image in fixing:
            turn = bundle.columns[image][:3]
            centre = bundle.columns[image][3:]
            rows[:3, turn] = bundle.R[image].T
            rows[3:6, centre] = np.eye(3) / extent
            rows[6, centre] = offsets[image] / extent**2
        return rows / len(fixing)


class _Adjustment:
    """The least squares of a bundle."""

    def linearised(self, fit: NormalEquations) -> Slopes:
        return fit.slopes

    def moved(self, fit: NormalEquations, step: np.ndarray) -> NormalEquations:
        return fit.moved(step)


@one_blas_thread()
def adjusted_bundle(whole: Bundle) -> NormalEquations:
    """The bundle of least loss near its start."""
    bundle = whole
    for _ in range(_ROUNDS):
        start = NormalEquations(bundle.with_inliers(whole))
        fit = minimised(_Adjustment(), start, _STEPS)
        bundle = fit.bundle
    return fit
