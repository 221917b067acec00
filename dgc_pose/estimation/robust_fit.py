"""Sampling and refinement of hypotheses, by PoseLib, and tests by homographies.

Seeded runs of LO-RANSAC with the five-point solver, or with solvers that have focal lengths among
their unknowns; robust least squares with the Cauchy loss of the Sampson errors.

A homography relates two images of a plane, and an essential matrix explains it.
"""

import numpy as np
import poselib

from dgc_pose.estimation.options import EstimationOptions
from dgc_pose.estimation.problem import Hypothesis, TwoViewProblem, pose_loss_width
from dgc_pose.geometry.epipolar import essential_from_pose
from dgc_pose.geometry.homography import (
    fit_homography,
    homography_poses,
    transfer_error,
)
from dgc_pose.system.parallel import in_threads

# Matches that a run draws its samples from, chosen at random for each run. The time of RANSAC grows
# with the matches that it scores; the hypotheses are compared and refined on all matches.
MAX_SAMPLED = 3000
MINIMAL = 5  # matches that determine an essential matrix
_MIN_ITERATIONS = 50  # of a run, however many inliers there are
_TRIALS = 12.0  # factor of the iterations that PoseLib derives from inliers; docs/experiments.md

_ROUNDS = 3  # of a refinement
_MIN_KEPT = 0.98  # of the inliers: a fit that keeps fewer is rejected

PLANAR_SHARE = 0.85  # of inliers that one homography explains on a plane
# Limit of a homography's transfer error over the epipolar threshold. The transfer error contains
# two coordinates of the noise, the epipolar error one: the same noise needs a wider limit.
TRANSFER_LIMIT = 1.75

# PoseLib expects pixels: normalised points are passed as pixels of a camera of this focal length.
FOCAL = 1000.0
CAMERA = {"model": "SIMPLE_PINHOLE", "width": 2, "height": 2, "params": [FOCAL, 0.0, 0.0]}


def sample(problem: TwoViewProblem, runs: int | None = None) -> list[Hypothesis]:
    """The hypotheses of RANSAC runs, with most inliers first. runs: their number, by default that
    of the options.

    Each run draws its samples from at most `MAX_SAMPLED` matches, chosen by its seed.
    Inliers are counted over all matches.
    """
    if len(problem) < MINIMAL:
        return []

    def run(seed: int) -> np.ndarray | None:
        drawn = draw(problem, seed) if len(problem) > MAX_SAMPLED else problem
        return essential_matrix(drawn, seed)

    matrices = in_threads(run, run_seeds(problem.options, runs))
    poses = [Hypothesis.of_essential(problem, E) for E in matrices if E is not None]
    return sorted(poses, key=lambda pose: -pose.num_inliers)  # of equal ones, the first run's


def run_seeds(options: EstimationOptions, runs: int | None = None) -> list[int]:
    """A seed for each run, all different, drawn from the one in the options."""
    seeds = np.random.SeedSequence(options.seed).generate_state(runs or options.runs)
    return [int(seed) % (2**31 - 1) for seed in seeds]


def draw(problem: TwoViewProblem, seed: int, most: int = MAX_SAMPLED) -> TwoViewProblem:
    """At most `most` of the matches, shuffled."""
    order = np.random.default_rng(seed).permutation(len(problem))
    return problem.subset(order[:most])


def essential_matrix(
    problem: TwoViewProblem, seed: int, iterations: int | None = None
) -> np.ndarray | None:
    """The essential matrix (3, 3) of one RANSAC run on at least five matches; None if it fails.

    The same seed gives the same answer to the bit. From its share of inliers, a run derives the
    iterations that draw a sample without outliers with a probability of 0.9999. It ends after
    `_TRIALS` times as many, and after at least `_MIN_ITERATIONS`.
    """
    points = _pixels(problem)
    settings = _ransac_options(problem, seed, iterations)
    return _essential(*poselib.estimate_relative_pose(*points, CAMERA, CAMERA, *settings))


def essential_and_focals(
    problem: TwoViewProblem, seed: int, *, shared: bool
) -> tuple[np.ndarray, np.ndarray] | None:
    """As `essential_matrix`, for points that were normalised by wrong focal lengths: one factor per
    image (2,), and E of the points divided by these factors. Returns E first.

    shared: whether the factors are equal (six-point solver). Otherwise they are the nearest to 1
    that the fundamental matrix allows (Kocur, Kyselica, Kukelova, CVPR 2024).
    """
    points = _pixels(problem)
    settings = _ransac_options(problem, seed)
    if shared:
        pair, info = poselib.estimate_shared_focal_relative_pose(*points, np.zeros(2), *settings)
        E = _essential(pair.pose, info)
        factors = np.full(2, pair.camera1.focal() / FOCAL)
    else:
        F, info = poselib.estimate_fundamental(*points, *settings)
        cameras = poselib.focals_from_fundamental_iterative(F, CAMERA, CAMERA)[:2]
        factors = np.array([camera.focal() / FOCAL for camera in cameras])
        first, second = (np.diag([factor * FOCAL, factor * FOCAL, 1.0]) for factor in factors)
        E = second @ F @ first
        E = E / np.linalg.norm(E) if info["num_inliers"] else None
    if E is None or not ((factors > 0) & np.isfinite(factors)).all():
        return None
    return E, factors


def _pixels(problem: TwoViewProblem) -> tuple[np.ndarray, np.ndarray]:
    return problem.points1 * FOCAL, problem.points2 * FOCAL


def _ransac_options(
    problem: TwoViewProblem, seed: int, iterations: int | None = None
) -> tuple[dict[str, float], dict[str, str | float]]:
    """PoseLib's options of a run and of its local optimisation."""
    threshold = problem.threshold * FOCAL
    most = iterations or problem.options.iterations
    ransac = {
        "max_iterations": most,
        "min_iterations": min(most, _MIN_ITERATIONS),
        "dyn_num_trials_mult": _TRIALS,
        "max_epipolar_error": threshold,
        "seed": seed,
    }
    return ransac, {"loss_type": "TRUNCATED", "loss_scale": threshold}


def _essential(pose: poselib.CameraPose, info: dict[str, float]) -> np.ndarray | None:
    length = np.linalg.norm(pose.t)
    if info["num_inliers"] == 0 or length < 1e-12 or not np.isfinite(pose.R).all():
        return None
    return essential_from_pose(pose.R, pose.t / length)


def refine(problem: TwoViewProblem, start: Hypothesis) -> Hypothesis:
    """The hypothesis after at most three fits, with the threshold as the width of the loss. The
    inliers are chosen anew after each fit; the fits end when they stay the same."""
    pose = start
    for _ in range(_ROUNDS):
        before = pose
        pose = refit(problem, pose)
        if np.array_equal(pose.inliers, before.inliers):
            break
    return pose


def refit(problem: TwoViewProblem, start: Hypothesis, *, adapt_width: bool = False) -> Hypothesis:
    """The hypothesis after least squares on its inliers in front of both cameras.

    adapt_width: take the width of the loss from the inliers' errors, three times in turn,
    instead of the threshold. Most inliers are far more accurate than the threshold, and the others
    would bias the pose. Returns `start` itself if it has no more than five such inliers, or if the
    fit would lose more than one inlier in fifty.
    """
    # An inlier behind a camera is an outlier that happens to lie near its epipolar line.
    inliers = problem.subset(start.inliers_in_front)
    if len(inliers) <= MINIMAL:
        return start
    R = start.R
    t = start.t
    for _ in range(_ROUNDS if adapt_width else 1):
        width = pose_loss_width(inliers, R, t) if adapt_width else problem.threshold
        R, t = least_squares_pose(inliers, R, t, width)
    fitted = Hypothesis.of_pose(problem, R, t)
    if not adapt_width:
        # The epipolar error does not depend on the sign of the translation; the depths do.
        opposite = Hypothesis.of_pose(problem, R, -t)
        fitted = max((fitted, opposite), key=lambda pose: (pose.num_inliers, pose.num_in_front))
    return fitted if fitted.num_inliers >= _MIN_KEPT * start.num_inliers else start


def least_squares_pose(
    inliers: TwoViewProblem, R: np.ndarray, t: np.ndarray, width: float
) -> tuple[np.ndarray, np.ndarray]:
    """R and unit t of least Cauchy loss, from a start. width: of the loss, in the points' unit."""
    start = poselib.CameraPose()
    start.R = R
    start.t = t
    options = {"loss_type": "CAUCHY", "loss_scale": width * FOCAL, "max_iterations": 100}
    pose, _ = poselib.refine_relative_pose(*_pixels(inliers), start, CAMERA, CAMERA, options)
    length = np.linalg.norm(pose.t)
    if length < 1e-12 or not np.isfinite(pose.R).all():
        return R, t
    return pose.R, pose.t / length


def fit_plane(problem: TwoViewProblem, pose: Hypothesis) -> tuple[float, np.ndarray | None]:
    """The share of a hypothesis' inliers that one homography explains, and the homography (3, 3);
    0 and None if there is none. From `PLANAR_SHARE` on, the inliers lie on a plane."""
    inliers = problem.subset(pose.inliers)
    limit = TRANSFER_LIMIT * problem.threshold
    H = fit_homography(inliers.points1, inliers.points2, limit, problem.options.seed)
    if H is None:
        return 0.0, None
    error = transfer_error(inliers.points1, inliers.points2, H)
    return float((error < limit).mean()), H


def planar_hypotheses(problem: TwoViewProblem, H: np.ndarray) -> list[Hypothesis]:
    """The poses that a plane's homography allows."""
    return [Hypothesis.of_pose(problem, R, t) for R, t in homography_poses(H)]


def best_planar(
    problem: TwoViewProblem, first: Hypothesis, H: np.ndarray, refined: bool
) -> Hypothesis:
    """The best of a hypothesis and the poses that a plane's homography allows.

    On a plane the five-point solver has a family of near solutions; the homography allows two, each
    with both signs of t. refined: whether to refine the poses of the homography first.
    """
    others = planar_hypotheses(problem, H)
    if refined:
        others = [refine(problem, other) for other in others]
    return max([first, *others], key=lambda pose: (pose.num_in_front, pose.num_inliers))
