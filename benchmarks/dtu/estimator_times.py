"""The pose stage against plain OpenCV on the same matches, in one run.

`python -m dgc_pose.benchmarks.dtu.estimator_times --root DIR` matches a few pairs, then gives every
pair's matches to the estimator of this package and to `cv2.findEssentialMat`, called once for each
run over permuted points, since it draws the same samples for the same order of points. Both in this
process, one after the other.
"""

from __future__ import annotations

import time
from collections.abc import Sequence
from dataclasses import dataclass
from typing import get_args

import click
import cv2
import numpy as np

from dgc_pose.benchmarks.dtu.dataset import open_dataset
from dgc_pose.benchmarks.dtu.entries import choose_pairs, make_entries
from dgc_pose.benchmarks.dtu.methods import load_engines, parse_methods
from dgc_pose.benchmarks.dtu.protocols import PairReader
from dgc_pose.benchmarks.dtu.records import Protocol
from dgc_pose.benchmarks.dtu.run import RunOptions, match_batch
from dgc_pose.benchmarks.pair_list import Pair
from dgc_pose.benchmarks.pairs import pose_errors
from dgc_pose.benchmarks.table import aligned
from dgc_pose.estimation import EstimationOptions, estimate_pose
from dgc_pose.estimation.problem import TwoViewProblem
from dgc_pose.matches import Matches
from dgc_pose.matching import MatchingOptions
from dgc_pose.metrics import rotation_error_deg, translation_error_deg

_CONFIDENCE = 1 - 1e-15  # anything less ends OpenCV's RANSAC after a few iterations


@dataclass(frozen=True)
class Compared:
    """One set of matches through both estimators: CPU seconds, errors in degrees (infinite without
    a pose)."""

    matches: int
    seconds: float
    rotation_deg: float
    translation_deg: float
    opencv_seconds: float
    opencv_rotation_deg: float
    opencv_translation_deg: float


def compare(matches: Matches, truth: Pair, options: EstimationOptions) -> Compared:
    """Estimate the pose of one pair by both. truth: its cameras are those of the matches."""
    start = time.process_time()
    pose = estimate_pose(matches, truth.camera1, truth.camera2, options)
    middle = time.process_time()
    found = opencv_pose(matches, truth, options)
    end = time.process_time()
    rotation, translation = pose_errors(pose, truth.R, truth.t)
    other = (np.inf, np.inf)
    if found is not None:
        R, t = found
        other = rotation_error_deg(R, truth.R), translation_error_deg(t, truth.t)
    return Compared(len(matches), middle - start, rotation, translation, end - middle, *other)


def opencv_pose(
    matches: Matches, truth: Pair, options: EstimationOptions
) -> tuple[np.ndarray, np.ndarray] | None:
    """R (3, 3) and t (3,) by `cv2.findEssentialMat` and `cv2.recoverPose`, None where they fail.

    The best by inliers of `options.runs` calls of RANSAC, of at most `options.iterations` each, on
    normalised points and by the same threshold as the estimator of this package.
    """
    problem = TwoViewProblem.of(matches, truth.camera1, truth.camera2, options)
    points1, points2 = problem.points1, problem.points2
    if len(points1) < 5:
        return None
    best: tuple[int, np.ndarray, np.ndarray] | None = None
    rng = np.random.default_rng(options.seed)
    for _ in range(options.runs):
        order = rng.permutation(len(points1))
        E, inliers = cv2.findEssentialMat(
            points1[order],
            points2[order],
            np.eye(3),
            cv2.RANSAC,
            _CONFIDENCE,
            problem.threshold,
            options.iterations,
        )
        if E is None or E.shape != (3, 3):
            continue
        if best is None or int(inliers.sum()) > best[0]:
            mask = np.zeros((len(points1), 1), np.uint8)
            mask[order] = inliers
            best = int(inliers.sum()), E, mask
    if best is None:
        return None
    _, R, t, _ = cv2.recoverPose(best[1], points1, points2, np.eye(3), mask=best[2])
    return R, t[:, 0]


def comparison_table(methods: Sequence[tuple[str, Sequence[Compared]]], estimator: str) -> str:
    """For each method both estimators' medians over its pairs, mean CPU seconds and their ratio."""
    rows = [("matches of", "mean", "estimator", "s/pair", "R med", "t med", "time")]
    for name, all_compared in methods:
        seconds = np.mean([one.seconds for one in all_compared])
        other = np.mean([one.opencv_seconds for one in all_compared])
        matches = f"{np.mean([one.matches for one in all_compared]):.0f}"
        ours = [(one.rotation_deg, one.translation_deg) for one in all_compared]
        theirs = [(one.opencv_rotation_deg, one.opencv_translation_deg) for one in all_compared]
        rows.append((name, matches, estimator, *_cells(seconds, ours), f"{seconds / other:.3f}"))
        rows.append((name, matches, "findEssentialMat", *_cells(other, theirs), "1"))
    return aligned(rows)


def _cells(seconds: np.floating, errors: Sequence[tuple[float, float]]) -> tuple[str, str, str]:
    rotation, translation = np.median(errors, axis=0)
    return f"{seconds:.3f}", f"{rotation:.2f}", f"{translation:.2f}"


@click.command()
@click.option("--root", required=True, metavar="DIR", help="Where DTU lies.")
@click.option("--scene", type=int, required=True, help="Number of the scene.")
@click.option("--pairs", default="10", show_default=True, metavar="N|FILE")
@click.option("--methods", default="dgcm-lite,dgcm-lite/all", show_default=True)
@click.option(
    "--protocol", type=click.Choice(get_args(Protocol)), default="paper", show_default=True
)
@click.option("--seed", default=0, show_default=True)
def main(
    root: str, scene: int, pairs: str, methods: str, protocol: Protocol, seed: int
) -> None:
    """The pose stage against plain OpenCV on the same matches."""
    chosen = parse_methods(methods.split(","))
    dataset = open_dataset(root, scenes=[scene])
    entries = make_entries(dataset, choose_pairs(dataset, pairs, seed=seed, scenes=[scene]))
    options = RunOptions(protocol, MatchingOptions(), EstimationOptions(seed=seed))
    engines = load_engines(chosen, {}, device="auto", options=options.matching)
    reader = PairReader(protocol)
    found: dict[str, list[Compared]] = {method.name: [] for method in chosen}
    for entry in entries:
        for job in match_batch([entry], chosen, engines, reader, options)[0]:
            found[job.method].append(compare(job.matches, job.truth, job.options))
    click.echo(
        f"{protocol} protocol, {len(entries)} pairs of scan{scene}; {options.estimation.runs} runs "
        f"of {options.estimation.iterations} iterations; medians in degrees, a failure infinite"
    )
    click.echo(comparison_table([*found.items()], options.estimation.estimator))


if __name__ == "__main__":
    main()
