"""RANSAC: several seeded runs, and their models."""

from __future__ import annotations

import numpy as np

from dgc_pose.estimation.model import Model
from dgc_pose.estimation.options import EstimationOptions
from dgc_pose.estimation.poselib_calls import MINIMAL, essential_matrix
from dgc_pose.estimation.problem import TwoViewProblem
from dgc_pose.system.threads import in_threads


def sampled_models(problem: TwoViewProblem, options: EstimationOptions) -> list[Model]:
    """The models of `options.runs` RANSAC runs, that with most inliers first.

    Each run draws its samples from at most `options.max_sampled` matches, chosen by its own seed.
    Inliers are counted over all matches.
    """
    if len(problem) < MINIMAL:
        return []

    def run(seed: int) -> np.ndarray | None:
        sampled = np.arange(len(problem))
        if len(problem) > options.max_sampled:
            sampled = np.random.default_rng(seed).permutation(sampled)[: options.max_sampled]
        return essential_matrix(
            problem.points1[sampled],
            problem.points2[sampled],
            threshold=problem.threshold,
            iterations=options.iterations,
            seed=seed,
        )

    matrices = in_threads(run, run_seeds(options))
    models = [Model.of_essential(problem, E) for E in matrices if E is not None]
    return sorted(models, key=lambda model: -model.count)  # of equals the first run's


def run_seeds(options: EstimationOptions) -> list[int]:
    """A seed for each run, all different, drawn from the one in the options."""
    seeds = np.random.SeedSequence(options.seed).generate_state(options.runs)
    return [int(seed) % (2**31 - 1) for seed in seeds]
