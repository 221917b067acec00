"""RANSAC: several seeded runs of a backend, and the models that they found."""

from __future__ import annotations

import numpy as np

from dgc_pose.estimation.backend import MINIMAL, Backend
from dgc_pose.estimation.model import Model
from dgc_pose.estimation.options import EstimationOptions, EstimatorName
from dgc_pose.estimation.problem import TwoViewProblem
from dgc_pose.system.threads import in_threads

# Backends with a random generator for each run. The others seed one of the process or thread.
_THREAD_SAFE: frozenset[EstimatorName] = frozenset({"poselib"})


def sampled_models(problem: TwoViewProblem, options: EstimationOptions) -> list[Model]:
    """The models of `options.runs` RANSAC runs, that with most inliers first.

    Each run draws its samples from at most `options.max_sampled` matches, chosen by its own seed.
    Inliers are counted here over all matches, the same way for every backend.
    """
    if len(problem) < MINIMAL:
        return []
    backend = get_backend(options.estimator)

    def run(seed: int) -> list[np.ndarray]:
        sampled = _sample(len(problem), options.max_sampled, seed)
        return backend(
            problem.points1[sampled],
            problem.points2[sampled],
            threshold=problem.threshold,
            iterations=options.iterations,
            seed=seed,
        )

    seeds = run_seeds(options)
    found = in_threads(run, seeds, None if options.estimator in _THREAD_SAFE else 1)
    models = [Model.of_essential(problem, E) for matrices in found for E in matrices]
    return sorted(models, key=lambda model: -model.count)  # of equals the first run's


def run_seeds(options: EstimationOptions) -> list[int]:
    """A seed for each run, all different, drawn from the one in the options."""
    seeds = np.random.SeedSequence(options.seed).generate_state(options.runs)
    # OpenCV and pycolmap take positive 32-bit seeds.
    return [int(seed) % (2**31 - 1) for seed in seeds]


def get_backend(name: EstimatorName) -> Backend:
    """The backend of that name. Its library is imported on the first call."""
    if name == "poselib":
        from dgc_pose.estimation.poselib_backend import run_poselib

        return run_poselib
    if name == "pycolmap":
        from dgc_pose.estimation.pycolmap_backend import run_pycolmap

        return run_pycolmap
    from dgc_pose.estimation.opencv_backend import run_opencv

    return run_opencv


def _sample(count: int, most: int, seed: int) -> np.ndarray | slice:
    """Indices of at most `most` of `count` matches, drawn at random; all if there are no more."""
    if count <= most:
        return slice(None)
    return np.random.default_rng(seed).permutation(count)[:most]
