"""The focal lengths that the matches determine, of cameras that are not exact.

Robust estimates at several focal lengths, and by solvers that have the focal length among their
unknowns, are starts. From the best of them pose and cameras are fitted together.

Where the matches do not determine the focal length (optical axes that meet, forward motion, a
plane, little perspective: Sturm 1999; Hartley and Zisserman, chapter 19) the prior does.
"""

from __future__ import annotations

import math
from dataclasses import replace

import numpy as np

from dgc_pose.cameras.camera import Camera
from dgc_pose.estimation.camera_spread import CameraSpread, deviating
from dgc_pose.estimation.hypothesis import Hypothesis
from dgc_pose.estimation.joint_fit import JointFit, JointPose
from dgc_pose.estimation.options import EstimationOptions
from dgc_pose.estimation.problem import TwoViewProblem
from dgc_pose.estimation.ransac import (
    draw,
    essential_and_focal,
    essential_and_focals,
    essential_matrix,
    run_seeds,
    sample,
)
from dgc_pose.system.threads import in_threads

SEARCH_RUNS = 3  # of RANSAC, as much work as the search is
_REACH = 2.0  # of the focal lengths that are tried, standard deviations to either side
_STEP = 0.23  # of ln f from each of them to the next
_SHARE = 4  # a run at one of them has the iterations over this
_MAX_STARTS = 3  # that are fitted


def fit_cameras(
    problem: TwoViewProblem, camera1: Camera, camera2: Camera, options: EstimationOptions
) -> tuple[JointPose, Camera, Camera] | None:
    """The most probable pose, and the cameras that it is of, with the standard deviations of the
    prior; None if RANSAC has no essential matrix.

    problem: normalised by the two cameras, whose standard deviations are the prior.
    """
    spread = CameraSpread.of(camera1, camera2)
    joint = JointFit(problem, spread)
    starts = [start for start in _starts(problem, spread, options) if start is not None]
    if not starts:
        return None
    best = sorted(starts, key=joint.cost)[:_MAX_STARTS]
    pose = min(in_threads(joint.fitted, best), key=joint.cost)
    deviations = joint.deviations(pose)
    return pose, deviating(camera1, deviations[:3]), deviating(camera2, deviations[3:])


def _starts(
    problem: TwoViewProblem, spread: CameraSpread, options: EstimationOptions
) -> list[JointPose | None]:
    """The results of the runs: at focal lengths within the prior's reach, and of a solver."""
    stds = np.array([np.linalg.norm(spread.basis[row]) for row in (0, 3)])
    count = math.ceil(2 * _REACH * stds.max() / _STEP)
    if count <= 1:  # the K of the prior are near enough
        return [
            JointPose(run.R, run.t, np.zeros(len(spread)))
            for run in sample(problem, options)[:_MAX_STARTS]
        ]
    tried = [stds * z for z in np.linspace(-_REACH, _REACH, count)]
    seeds = run_seeds(replace(options, runs=count + 1))
    less = replace(options, iterations=max(1, options.iterations // _SHARE))

    def run(number: int) -> JointPose | None:
        if number == count:
            return solved_start(problem, spread, options, seeds[number])
        log_factors = tried[number]
        drawn = draw(_rescaled(problem, log_factors), seeds[number])
        E = essential_matrix(drawn, less, seeds[number])
        return None if E is None else _start(problem, spread, E, log_factors)

    return in_threads(run, list(range(count, -1, -1)))  # the longest first


def solved_start(
    problem: TwoViewProblem, spread: CameraSpread, options: EstimationOptions, seed: int
) -> JointPose | None:
    """A pose with focal lengths by RANSAC on a solver that has them among its unknowns; None if it
    fails, and if a focal length is exact."""
    if spread.shared_focal:
        result = essential_and_focal(draw(problem, seed), options, seed)
    elif spread.basis[[0, 3]].any(axis=1).all():
        result = essential_and_focals(draw(problem, seed), options, seed)
    else:
        return None
    return None if result is None else _start(problem, spread, result[0], np.log(result[1]))


def _rescaled(problem: TwoViewProblem, log_factors: np.ndarray) -> TwoViewProblem:
    """The problem for focal lengths that are larger by factors."""
    shrink = np.exp(-log_factors)
    return replace(
        problem,
        points1=problem.points1 * shrink[0],
        points2=problem.points2 * shrink[1],
        threshold=problem.threshold * float(shrink.mean()),
    )


def _start(
    problem: TwoViewProblem, spread: CameraSpread, E: np.ndarray, log_factors: np.ndarray
) -> JointPose | None:
    pose = Hypothesis.of_essential(_rescaled(problem, log_factors), E)
    deviations = np.zeros(6)
    deviations[[0, 3]] = log_factors
    z = np.linalg.lstsq(spread.basis, deviations, rcond=None)[0]
    return JointPose(pose.R, pose.t, z)
