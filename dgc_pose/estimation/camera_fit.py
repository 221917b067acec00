"""The focal lengths that the matches determine, for cameras that are not exact.

Fits start from RANSAC at several focal lengths, and with solvers that have the focal length among
their unknowns. The best starts are refined in pose and cameras together. The cost is the Cauchy
loss of the Sampson errors, divided by the number of matches with correlated errors, plus half the
squares of the parameters over their standard deviations: its minimum is the most probable.

Where the matches do not determine the focal length (optical axes that meet, forward motion, a
plane, little perspective: Sturm 1999; Hartley and Zisserman, chapter 19), the prior does.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass, replace
from functools import cached_property, partial

import cv2
import numpy as np

from dgc_pose.estimation.intrinsics_prior import (
    ASPECTS,
    FOCALS,
    SIZE,
    IntrinsicsPrior,
    by_parameters,
    error_slopes,
    renormalised_pair,
)
from dgc_pose.estimation.least_squares import (
    Slopes,
    cauchy_slopes,
    loss_width,
    match_variance,
    minimised,
)
from dgc_pose.estimation.problem import Hypothesis, TwoViewProblem
from dgc_pose.estimation.robust_fit import (
    MINIMAL,
    draw,
    essential_and_focals,
    essential_matrix,
    run_seeds,
    sample,
)
from dgc_pose.geometry.epipolar import (
    depths,
    epipolar_lines,
    essential_from_pose,
    sampson_distance,
    tangent_axes,
)
from dgc_pose.system.parallel import in_threads

SEARCH_RUNS = 3  # RANSAC runs that take as long as the search of focal lengths
_REACH = 2.0  # focal lengths are tried up to this many standard deviations to either side
_STEP = 0.23  # of ln f between them
_SHARE = 4  # a run at one of them has the iterations divided by this
_MAX_STARTS = 3  # starts that are fitted
_FITTED = 1000  # matches that they are fitted to
LIMITS = (3.0, 1.0, 1.0)  # largest errors of the matches in each round of a fit, thresholds
MOST_ERROR = 3.0  # thresholds; larger errors count as this one
_TRIED_TOGETHER = (-0.5, -0.25, 0.0, 0.25, 0.5)  # ln f of both cameras
_TRIED_APART = (-0.35, -0.18, 0.18, 0.35)  # ln f of one
ROUGH_ITERATIONS = 10  # of a fit that need not be the minimum
_ITERATIONS = 30  # of a fit, which usually converges in 10
_LARGEST_STEP = 0.5  # change of ln f in an iteration


@dataclass(frozen=True, eq=False)
class JointPose:
    """A pose x2 = R x1 + t, and how far the cameras are from those that normalised the matches."""

    R: np.ndarray  # (3, 3)
    t: np.ndarray  # (3,), unit length
    z: np.ndarray  # (M,) parameters in the basis of an `IntrinsicsPrior`, standard deviations

    def moved(self, step: np.ndarray) -> JointPose:
        """The pose after a step (5 + M,), see `error_slopes`."""
        R = cv2.Rodrigues(step[:3])[0] @ self.R
        t = self.t + tangent_axes(self.t) @ step[3:5]
        return JointPose(R, t / np.linalg.norm(t), self.z + step[5:])


@dataclass(frozen=True, eq=False)
class JointFit:
    """Least squares of pose and cameras for one problem whose cameras are not exact."""

    problem: TwoViewProblem
    width: float = math.inf  # of the losses, in the problem's unit; `linearised`, `slopes` need it

    @cached_property
    def prior(self) -> IntrinsicsPrior:
        """The prior of the cameras."""
        return IntrinsicsPrior.of(*self.problem.cameras)

    def parameters(self, pose: JointPose) -> np.ndarray:
        """The parameters (2 * SIZE,) of both cameras, see `IntrinsicsPrior`."""
        return self.prior.basis @ pose.z

    def cost(self, pose: JointPose) -> float:
        """The cost by which starts are compared: truncated squares of the errors, with the
        threshold as the width of the loss, and the squares of the parameters."""
        squares = np.minimum((self._errors(pose) / self.problem.threshold) ** 2, 1.0)
        squares[~self._in_front(pose)] = 1.0
        return float(squares.sum() / match_variance(1.0) + pose.z @ pose.z) / 2

    def fitted(
        self, pose: JointPose, limits: Sequence[float] = LIMITS, iterations: int = _ITERATIONS
    ) -> JointPose:
        """The pose after several fits to its inliers, which are chosen anew before each fit.

        limits: largest error of an inlier in each fit, thresholds.
        """
        threshold = self.problem.threshold
        for limit in limits:
            error = self._errors(pose)
            in_front = self._in_front(pose)
            near = error < threshold
            # The errors do not depend on the sign of t.
            if (near & ~in_front).sum() > (near & in_front).sum():
                pose = replace(pose, t=-pose.t)
                in_front = self._in_front(pose)
            chosen = (error < threshold * limit) & in_front
            if chosen.sum() <= MINIMAL + len(self.prior):
                return pose
            width = loss_width(error[chosen], threshold)
            pose = minimised(JointFit(self.problem.subset(chosen), width), pose, iterations)
        return pose

    def linearised(self, pose: JointPose) -> Slopes:
        """The losses of all matches and the prior, by the pose and the parameters (5 + M,)."""
        return self._slopes(pose, self.prior).with_prior(pose.z)

    def moved(self, pose: JointPose, step: np.ndarray) -> JointPose:
        """The pose after a step (5 + M,), which is shortened if a focal length changes too much."""
        change = np.abs((self.prior.basis @ step[5:])[FOCALS]).max(initial=0)
        return pose.moved(step * min(1.0, _LARGEST_STEP / max(change, 1e-12)))

    def slopes(self, pose: JointPose, prior: IntrinsicsPrior) -> Slopes:
        """The losses by the pose and a prior's parameters (5 + M,), without the prior itself and
        without errors above `MOST_ERROR`."""
        counted = self._errors(pose) < MOST_ERROR * self.problem.threshold
        part = JointFit(self.problem.subset(counted), self.width)
        return part._slopes(pose, prior)

    def _slopes(self, pose: JointPose, prior: IntrinsicsPrior) -> Slopes:
        error, slopes, _ = error_slopes(self.problem, pose.R, pose.t, prior, self.parameters(pose))
        return cauchy_slopes(error, slopes, self.width)

    def _errors(self, pose: JointPose) -> np.ndarray:
        """Sampson errors (N,), in the problem's unit; infinite if a distortion is not undone."""
        parameters = self.parameters(pose)
        E = essential_from_pose(pose.R, pose.t)
        error = sampson_distance(*renormalised_pair(self.problem, parameters), E)
        return np.nan_to_num(error * np.exp(parameters[FOCALS].mean()), nan=np.inf)

    def errors_px(self, pose: JointPose) -> np.ndarray:
        """Sampson errors (N,) in the images, pixels; infinite if a distortion is not undone. Points
        behind a camera count too: noise moves distant points to either side."""
        parameters = self.parameters(pose)
        E = essential_from_pose(pose.R, pose.t)
        points1, points2 = renormalised_pair(self.problem, parameters)
        algebraic, lines1, lines2 = epipolar_lines(points1, points2, E)
        squared = np.zeros(len(points1))
        sides = (self.problem.points1, points1, lines1), (self.problem.points2, points2, lines2)
        for number, (seen, undone, lines) in enumerate(sides):
            lens = self.problem.lenses[number]
            own = np.split(parameters, 2)[number]
            by_shift = by_parameters(seen, lens, own, undone, lines)[1:3]
            squared += ((by_shift / self.problem.cameras[number].focal) ** 2).sum(0)
        with np.errstate(divide="ignore", invalid="ignore"):
            error = np.abs(algebraic) / np.sqrt(squared)
        return np.where(np.isfinite(error), error, np.inf)

    def _in_front(self, pose: JointPose) -> np.ndarray:
        """Which points are in front of both cameras, (N,) bool."""
        depth1, depth2 = depths(
            *renormalised_pair(self.problem, self.parameters(pose)), pose.R, pose.t
        )
        return (depth1 > 0) & (depth2 > 0)


def joint_pose(joint: JointFit) -> JointPose | None:
    """The most probable pose and cameras, under the prior of the fit; None if RANSAC finds no
    essential matrix."""
    starts = [start for start in _starts(joint) if start is not None]
    if not starts:
        return None
    some = JointFit(draw(joint.problem, joint.problem.options.seed, _FITTED))
    best = sorted(starts, key=joint.cost)[:_MAX_STARTS]
    fits = in_threads(lambda start: some.fitted(start, LIMITS[:-1]), best)
    return joint.fitted(min(fits, key=joint.cost), LIMITS[-1:])


def rough_pose(joint: JointFit) -> JointPose | None:
    """A pose and cameras near the most probable ones: the best start of a coarse grid of both focal
    lengths, and not fitted to the end."""
    tried = [(k, k) for k in _TRIED_TOGETHER] + [(-k, k) for k in _TRIED_APART]
    seeds = run_seeds(joint.problem.options, len(tried) + 1)
    runs = [
        partial(start_at, joint, focal_parameters(np.array(at)), seed)
        for at, seed in zip(tried, seeds[:-1], strict=True)
    ]
    runs.append(partial(solved_start, joint, seeds[-1]))
    starts = [start for start in in_threads(lambda run: run(), runs[::-1]) if start is not None]
    best = min(starts, key=joint.cost, default=None)
    return None if best is None else joint.fitted(best, LIMITS[:-1], ROUGH_ITERATIONS)


def _starts(joint: JointFit) -> list[JointPose | None]:
    """Results of RANSAC runs at focal lengths within the prior's reach, and of `solved_start`."""
    stds = np.array([np.linalg.norm(joint.prior.basis[row]) for row in FOCALS])
    count = math.ceil(2 * _REACH * stds.max() / _STEP)
    if count <= 1:  # the prior is narrow: one focal length is near enough
        return [
            JointPose(run.R, run.t, np.zeros(len(joint.prior)))
            for run in sample(joint.problem)[:_MAX_STARTS]
        ]
    tried = [stds * z for z in np.linspace(-_REACH, _REACH, count)]
    seeds = run_seeds(joint.problem.options, count + 1)
    less = max(1, joint.problem.options.iterations // _SHARE)
    runs = [
        partial(start_at, joint, focal_parameters(at), seed, less)
        for at, seed in zip(tried, seeds[:-1], strict=True)
    ]
    runs.append(partial(solved_start, joint, seeds[-1]))
    return in_threads(lambda run: run(), runs[::-1])  # the longest first


def solved_start(joint: JointFit, seed: int) -> JointPose | None:
    """Pose and focal lengths by RANSAC with a solver that has both as unknowns; None if it fails
    or a focal length is exact."""
    first, second = joint.prior.basis[FOCALS]
    if not (first.any() and second.any()):
        return None
    shared = bool((first == second).all())  # off by the same factor
    result = essential_and_focals(draw(joint.problem, seed), seed, shared=shared)
    return None if result is None else _start(joint, result[0], focal_parameters(np.log(result[1])))


def focal_parameters(log_focals: np.ndarray, aspects: np.ndarray | float = 0.0) -> np.ndarray:
    """The parameters (2 * SIZE,) of cameras with these changes of ln f and of ln fy / fx."""
    parameters = np.zeros(2 * SIZE)
    parameters[FOCALS] = log_focals
    parameters[ASPECTS] = aspects
    return parameters


def start_at(
    joint: JointFit, parameters: np.ndarray, seed: int, iterations: int | None = None
) -> JointPose | None:
    """The pose of one RANSAC run on cameras with parameters (2 * SIZE,), as far as the prior allows
    them; None if it fails."""
    basis = joint.prior.basis
    parameters = basis @ np.linalg.lstsq(basis, parameters, rcond=None)[0]
    drawn = draw(_rescaled(joint.problem, parameters), seed)
    E = essential_matrix(drawn, seed, iterations)
    return None if E is None else _start(joint, E, parameters)


def _rescaled(problem: TwoViewProblem, parameters: np.ndarray) -> TwoViewProblem:
    """The problem for cameras with parameters (2 * SIZE,); the lens parameters must be 0."""
    points1, points2 = renormalised_pair(problem, parameters)
    shrink = float(np.exp(-parameters[FOCALS]).mean())
    moved = replace(problem, points1=points1, points2=points2, threshold=problem.threshold * shrink)
    return moved.subset(np.isfinite(points1).all(1) & np.isfinite(points2).all(1))


def _start(joint: JointFit, E: np.ndarray, parameters: np.ndarray) -> JointPose:
    pose = Hypothesis.of_essential(_rescaled(joint.problem, parameters), E)
    z = np.linalg.lstsq(joint.prior.basis, parameters, rcond=None)[0]
    return JointPose(pose.R, pose.t, z)
