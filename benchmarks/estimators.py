"""The estimators on synthetic matches: `python -m dgc_pose.benchmarks.estimators`."""

from __future__ import annotations

import time
from collections.abc import Callable, Sequence
from typing import get_args

import click
import numpy as np
from scipy.spatial.transform import Rotation

from dgc_pose.benchmarks.pairs import pose_errors
from dgc_pose.camera import Camera
from dgc_pose.estimation import EstimationOptions, EstimatorName, estimate_pose
from dgc_pose.estimation.model import Model
from dgc_pose.estimation.problem import TwoViewProblem
from dgc_pose.estimation.ransac import get_backend
from dgc_pose.matches import Matches
from dgc_pose.metrics import rotation_error_deg, translation_error_deg

SIZE = (1600, 1200)
CAMERA = Camera(np.array([[1600.0, 0, 799.5], [0, 1600, 599.5], [0, 0, 1]]), SIZE)
ESTIMATORS: tuple[EstimatorName, ...] = get_args(EstimatorName)
OUTLIERS = 0.5


def synthetic_matches(
    seed: int, count: int, sigma_px: float, outliers: float
) -> tuple[Matches, np.ndarray, np.ndarray]:
    """Matches of two views that orbit a cloud of points by 20 degrees, and their pose R, t.

    Gaussian noise of sigma_px in each coordinate of either image; a share `outliers` anywhere.
    """
    rng = np.random.default_rng(seed)
    axis = rng.standard_normal(3) * (0.3, 1.0, 0.3)
    R = Rotation.from_rotvec(np.radians(20) * axis / np.linalg.norm(axis)).as_matrix()
    middle = np.array([0.0, 0.0, 6.0])
    t = middle - R @ middle + 0.3 * rng.standard_normal(3)
    points = middle + rng.uniform(-1, 1, (8 * count, 3)) * (2.5, 2.0, 2.0)
    pixels = np.stack([_project(points), _project(points @ R.T + t)])
    inside = ((pixels >= 0) & (pixels <= np.subtract(SIZE, 1))).all((0, 2))
    seen = pixels[:, np.flatnonzero(inside)[:count]]
    seen = seen + sigma_px * rng.standard_normal(seen.shape)
    wrong = round(outliers * seen.shape[1])
    seen[:, :wrong] = rng.random((2, wrong, 2)) * SIZE
    confidence = np.ones(seen.shape[1])
    return Matches(seen[0], seen[1], confidence, sigma_px), R, t / np.linalg.norm(t)


def _project(points: np.ndarray) -> np.ndarray:
    return (points @ CAMERA.K.T)[:, :2] / points[:, 2:]


def measure(
    seeds: int, count: int, sigma_px: float, options: EstimationOptions
) -> tuple[float, float, float, int]:
    """Medians over the scenes of R error, t error (degrees; failures infinite) and CPU seconds, and
    how many scenes got a pose."""
    rows = []
    for seed in range(seeds):
        matches, R, t = synthetic_matches(seed, count, sigma_px, OUTLIERS)
        start = time.process_time()
        pose = estimate_pose(matches, CAMERA, CAMERA, options)
        seconds = time.process_time() - start
        rows.append((*pose_errors(pose, R, t), seconds, float(pose.success)))
    table = np.array(rows)
    rotation, translation, seconds = np.median(table[:, :3], axis=0)
    return float(rotation), float(translation), float(seconds), int(table[:, 3].sum())


def backends_table(seeds: int) -> list[str]:
    """Every estimator over counts and noise."""
    lines = [
        "| estimator | matches | sigma px | R error deg | t error deg | poses | CPU seconds |",
        "|---|---|---|---|---|---|---|",
    ]
    for estimator in ESTIMATORS:
        for count in (5_000, 20_000):
            for sigma in (1.0, 3.0):
                options = EstimationOptions(estimator=estimator)
                R, t, seconds, poses = measure(seeds, count, sigma, options)
                lines.append(
                    f"| {estimator} | {count} | {sigma:g} | {R:.4f} | {t:.4f} | "
                    f"{poses} of {seeds} | {seconds:.2f} |"
                )
    return lines


def thresholds_table(seeds: int) -> list[str]:
    """The default estimator over the threshold, as a multiple of the noise."""
    lines = [
        "| threshold_factor | refined | R error deg | t error deg | poses |",
        "|---|---|---|---|---|",
    ]
    for refine in (True, False):
        for factor in (1.0, 1.5, 2.0, 3.0, 4.0):
            options = EstimationOptions(threshold_factor=factor, refine=refine)
            R, t, _, poses = measure(seeds, 2_000, 2.0, options)
            lines.append(
                f"| {factor:g} | {'yes' if refine else 'no'} | {R:.4f} | {t:.4f} | "
                f"{poses} of {seeds} |"
            )
    return lines


def speed_table(seeds: int) -> list[str]:
    """The whole pose stage on 20,000 matches beside one bare run of pycolmap, and of PoseLib."""
    count, sigma = 20_000, 1.0
    rows = []
    for seed in range(seeds):
        matches, R, t = synthetic_matches(seed, count, sigma, OUTLIERS)
        start = time.process_time()
        pose = estimate_pose(matches, CAMERA, CAMERA)
        stage = time.process_time() - start
        problem = TwoViewProblem.of(matches, CAMERA, CAMERA)
        row = [(*pose_errors(pose, R, t), stage)]
        bare: tuple[EstimatorName, ...] = ("pycolmap", "poselib")
        for name in bare:
            backend = get_backend(name)
            start = time.process_time()
            found = backend(
                problem.points1,
                problem.points2,
                threshold=problem.threshold,
                iterations=1000,
                seed=seed,
            )
            seconds = time.process_time() - start
            model = Model.of_essential(problem, found[0])
            errors = rotation_error_deg(model.R, R), translation_error_deg(model.t, t)
            row.append((*errors, seconds))
        rows.append(row)
    medians = np.median(np.array(rows), axis=0)
    labels = ("pose stage, 5 x 1000 iterations", "pycolmap, 1 x 1000", "PoseLib, 1 x 1000")
    lines = [
        "| 20,000 matches | R error deg | t error deg | CPU seconds | over pycolmap |",
        "|---|---|---|---|---|",
    ]
    for label, (R_error, t_error, seconds) in zip(labels, medians, strict=True):
        ratio = seconds / medians[1, 2]
        lines.append(f"| {label} | {R_error:.4f} | {t_error:.4f} | {seconds:.3f} | {ratio:.2f} |")
    return lines


def chance_table(seeds: int) -> list[str]:
    """How often matches of nothing at all get a pose, over their count and the threshold."""
    thresholds = (1.0, 3.0, 10.0, 20.0)
    lines = [
        "| random matches | " + " | ".join(f"{threshold:g} px" for threshold in thresholds) + " |",
        "|---|" + "---|" * len(thresholds),
    ]
    for count in (20, 30, 50, 100, 500, 2_000, 20_000):
        trials = max(seeds, seeds * 200 // count)
        cells = [f"{false_poses(trials, count, threshold)} of {trials}" for threshold in thresholds]
        lines.append(f"| {count} | " + " | ".join(cells) + " |")
    return lines


def false_poses(trials: int, count: int, threshold_px: float) -> int:
    """How many of so many sets of random matches get a pose."""
    options = EstimationOptions(threshold_px=threshold_px)
    found = 0
    for seed in range(trials):
        matches, _, _ = synthetic_matches(seed, count, 1.0, outliers=1.0)
        found += estimate_pose(matches, CAMERA, CAMERA, options).success
    return found


STUDIES: dict[str, Callable[[int], Sequence[str]]] = {
    "backends": backends_table,
    "thresholds": thresholds_table,
    "speed": speed_table,
    "chance": chance_table,
}


@click.command()
@click.option("--study", type=click.Choice([*STUDIES]), multiple=True, help="Default: all.")
@click.option("--seeds", type=click.IntRange(1), default=5, show_default=True, help="Scenes each.")
def main(study: tuple[str, ...], seeds: int) -> None:
    """Accuracy and time of the robust estimators on synthetic matches, half of them wrong."""
    for name in study or STUDIES:
        click.echo("\n".join([f"{name}, {seeds} scenes each", "", *STUDIES[name](seeds), ""]))


if __name__ == "__main__":
    main()
