"""PoseLib: seeded runs of LO-RANSAC on the five-point solver, and the refinement of a pose."""

from collections.abc import Callable
from typing import TypeVar

import numpy as np
import poselib

from dgc_pose.estimation.model import Model
from dgc_pose.estimation.options import EstimationOptions
from dgc_pose.estimation.problem import TwoViewProblem
from dgc_pose.geometry.epipolar import essential_from_pose
from dgc_pose.system.threads import in_threads

Result = TypeVar("Result")

# Matches that a run draws its samples from, chosen at random for each run. The time of RANSAC grows
# with the matches that it scores; the models are compared and refined on all matches.
MAX_SAMPLED = 3000
MINIMAL = 5  # matches that determine an essential matrix
_LEAST_ITERATIONS = 200  # of a run, however many inliers there are; see docs/experiments.md

# PoseLib expects pixels: normalised points are passed as pixels of a camera of this focal length.
_FOCAL = 1000.0
_CAMERA = {"model": "SIMPLE_PINHOLE", "width": 2, "height": 2, "params": [_FOCAL, 0.0, 0.0]}


def sampled_models(problem: TwoViewProblem, options: EstimationOptions) -> list[Model]:
    """The models of `options.runs` RANSAC runs, that with most inliers first.

    Each run draws its samples from at most `MAX_SAMPLED` matches, chosen by its seed.
    Inliers are counted over all matches.
    """
    if len(problem) < MINIMAL:
        return []

    def run(seed: int) -> np.ndarray | None:
        sampled = np.arange(len(problem))
        if len(problem) > MAX_SAMPLED:
            sampled = np.random.default_rng(seed).permutation(sampled)[:MAX_SAMPLED]
        return run_on(sampled, essential_matrix, problem, options, seed)

    matrices = in_threads(run, run_seeds(options))
    models = [Model.of_essential(problem, E) for E in matrices if E is not None]
    return sorted(models, key=lambda model: -model.count)  # of equals the first run's


def run_on(
    sampled: np.ndarray,
    estimate: Callable[..., Result],
    problem: TwoViewProblem,
    options: EstimationOptions,
    seed: int,
) -> Result:
    """A run of RANSAC, by one of the solvers below, on some of the matches. sampled: indices."""
    return estimate(
        problem.points1[sampled],
        problem.points2[sampled],
        threshold=problem.threshold,
        iterations=options.iterations,
        seed=seed,
    )


def run_seeds(options: EstimationOptions) -> list[int]:
    """A seed for each run, all different, drawn from the one in the options."""
    seeds = np.random.SeedSequence(options.seed).generate_state(options.runs)
    return [int(seed) % (2**31 - 1) for seed in seeds]


def essential_matrix(
    points1: np.ndarray, points2: np.ndarray, *, threshold: float, iterations: int, seed: int
) -> np.ndarray | None:
    """The essential matrix (3, 3) of one RANSAC run; None if it fails.

    points1, points2: normalised (N, 2), N >= 5; threshold: Sampson distance in the same unit. The
    same seed gives the same answer to the bit. A run ends as soon as its share of inliers shows
    that a sample without outliers was drawn, with PoseLib's probability of 0.9999.
    """
    pose, info = poselib.estimate_relative_pose(
        points1 * _FOCAL,
        points2 * _FOCAL,
        _CAMERA,
        _CAMERA,
        *_ransac_options(threshold, iterations, seed),
    )
    return _essential(pose, info)


def essential_and_focal(
    points1: np.ndarray, points2: np.ndarray, *, threshold: float, iterations: int, seed: int
) -> tuple[np.ndarray, float] | None:
    """As `essential_matrix`, for points that were normalised by a focal length that is wrong by the
    same factor in both images: E of the points divided by that factor, and the factor (six-point
    solver)."""
    pair, info = poselib.estimate_shared_focal_relative_pose(
        points1 * _FOCAL,
        points2 * _FOCAL,
        np.zeros(2),
        *_ransac_options(threshold, iterations, seed),
    )
    E, factor = _essential(pair.pose, info), pair.camera1.focal() / _FOCAL
    return None if E is None or not 0 < factor < np.inf else (E, factor)


def essential_and_focals(
    points1: np.ndarray, points2: np.ndarray, *, threshold: float, iterations: int, seed: int
) -> tuple[np.ndarray, float, float] | None:
    """As `essential_and_focal`, with a factor for each image, by the fundamental matrix: the
    factors nearest to 1 that it allows (Kocur, Kyselica, Kukelova, CVPR 2024)."""
    F, info = poselib.estimate_fundamental(
        points1 * _FOCAL, points2 * _FOCAL, *_ransac_options(threshold, iterations, seed)
    )
    if info["num_inliers"] == 0:
        return None
    camera1, camera2, _ = poselib.focals_from_fundamental_iterative(F, _CAMERA, _CAMERA)
    factors = np.array([camera1.focal(), camera2.focal()]) / _FOCAL
    if not ((factors > 0) & np.isfinite(factors)).all():
        return None
    first, second = (np.diag([factor * _FOCAL, factor * _FOCAL, 1.0]) for factor in factors)
    E = second @ F @ first
    return E / np.linalg.norm(E), float(factors[0]), float(factors[1])


def _ransac_options(
    threshold: float, iterations: int, seed: int
) -> tuple[dict[str, float], dict[str, str | float]]:
    """PoseLib's options of a run and of its local optimisation."""
    ransac = {
        "max_iterations": iterations,
        "min_iterations": min(iterations, _LEAST_ITERATIONS),
        "max_epipolar_error": threshold * _FOCAL,
        "seed": seed,
    }
    return ransac, {"loss_type": "TRUNCATED", "loss_scale": threshold * _FOCAL}


def _essential(pose: poselib.CameraPose, info: dict[str, float]) -> np.ndarray | None:
    length = np.linalg.norm(pose.t)
    if info["num_inliers"] == 0 or length < 1e-12 or not np.isfinite(pose.R).all():
        return None
    return essential_from_pose(pose.R, pose.t / length)


def refine_pose(
    points1: np.ndarray, points2: np.ndarray, R: np.ndarray, t: np.ndarray, scale: float
) -> tuple[np.ndarray, np.ndarray]:
    """The pose that minimises the Cauchy loss of the Sampson errors of normalised points (N, 2).

    scale: of the loss, in the points' unit. Returns R and unit t.
    """
    start = poselib.CameraPose()
    start.R, start.t = R, t
    options = {"loss_type": "CAUCHY", "loss_scale": scale * _FOCAL, "max_iterations": 100}
    pose, _ = poselib.refine_relative_pose(
        points1 * _FOCAL, points2 * _FOCAL, start, _CAMERA, _CAMERA, options
    )
    length = np.linalg.norm(pose.t)
    if length < 1e-12 or not np.isfinite(pose.R).all():
        return R, t
    return pose.R, pose.t / length
