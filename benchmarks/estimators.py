"""The robust estimators: on synthetic matches, half of them wrong, and beside plain OpenCV."""

from __future__ import annotations

import time
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from itertools import product
from typing import get_args

import cv2
import numpy as np
from scipy.spatial.transform import Rotation

from dgc_pose.benchmarks.posed_pairs import Truth
from dgc_pose.benchmarks.scores import pose_errors
from dgc_pose.benchmarks.table import aligned
from dgc_pose.cameras.camera import Camera
from dgc_pose.estimation import EstimationOptions, EstimatorName, estimate_pose
from dgc_pose.estimation.backend import MINIMAL
from dgc_pose.estimation.model import Model
from dgc_pose.estimation.problem import TwoViewProblem
from dgc_pose.estimation.ransac import get_backend
from dgc_pose.matches import Matches
from dgc_pose.metrics import rotation_error_deg, translation_error_deg

SIZE = (1600, 1200)
CAMERA = Camera(np.array([[1600.0, 0, 799.5], [0, 1600, 599.5], [0, 0, 1]]), SIZE)
ESTIMATORS: tuple[EstimatorName, ...] = get_args(EstimatorName)
OUTLIERS = 0.5
_BARE: tuple[EstimatorName, ...] = ("pycolmap", "poselib")  # beside the whole pose stage
_ERRORS = ("R error deg", "t error deg")
_CONFIDENCE = 1 - 1e-15  # with less, OpenCV's RANSAC ends after a few iterations

Errors = tuple[float, float]  # of R and of t in degrees, infinite without a pose


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
    rows = [("estimator", "matches", "sigma px", *_ERRORS, "poses", "CPU seconds")]
    for estimator, count, sigma in product(ESTIMATORS, (5_000, 20_000), (1.0, 3.0)):
        options = EstimationOptions(estimator=estimator)
        R, t, seconds, poses = measure(seeds, count, sigma, options)
        errors = f"{R:.4f}", f"{t:.4f}"
        found = f"{poses} of {seeds}"
        rows.append((estimator, str(count), f"{sigma:g}", *errors, found, f"{seconds:.2f}"))
    return _markdown(rows)


def thresholds_table(seeds: int) -> list[str]:
    """The default estimator over the threshold, as a multiple of the noise."""
    rows = [("threshold_factor", "refined", *_ERRORS, "poses")]
    for refine, factor in product((True, False), (1.0, 1.5, 2.0, 3.0, 4.0)):
        options = EstimationOptions(threshold_factor=factor, refine=refine)
        R, t, _, poses = measure(seeds, 2_000, 2.0, options)
        errors = f"{R:.4f}", f"{t:.4f}"
        rows.append((f"{factor:g}", "yes" if refine else "no", *errors, f"{poses} of {seeds}"))
    return _markdown(rows)


def speed_table(seeds: int) -> list[str]:
    """The whole pose stage on 20,000 matches beside one bare run of pycolmap, and of PoseLib."""
    measured = []
    for seed in range(seeds):
        matches, R, t = synthetic_matches(seed, 20_000, 1.0, OUTLIERS)
        start = time.process_time()
        pose = estimate_pose(matches, CAMERA, CAMERA)
        of_seed = [(*pose_errors(pose, R, t), time.process_time() - start)]
        problem = TwoViewProblem.of(matches, CAMERA, CAMERA)
        points1, points2 = problem.points1, problem.points2
        for name in _BARE:
            backend, threshold = get_backend(name), problem.threshold
            start = time.process_time()
            found = backend(points1, points2, threshold=threshold, iterations=1000, seed=seed)
            seconds = time.process_time() - start
            model = Model.of_essential(problem, found[0])
            errors = rotation_error_deg(model.R, R), translation_error_deg(model.t, t)
            of_seed.append((*errors, seconds))
        measured.append(of_seed)
    medians = np.median(np.array(measured), axis=0)
    labels = ("pose stage, 5 x 1000 iterations", "pycolmap, 1 x 1000", "PoseLib, 1 x 1000")
    rows = [("20,000 matches", *_ERRORS, "CPU seconds", "over pycolmap")]
    for label, (R_error, t_error, seconds) in zip(labels, medians, strict=True):
        ratio = f"{seconds / medians[1, 2]:.2f}"
        rows.append((label, f"{R_error:.4f}", f"{t_error:.4f}", f"{seconds:.3f}", ratio))
    return _markdown(rows)


def chance_table(seeds: int) -> list[str]:
    """How often random matches get a pose, over their count and the threshold."""
    thresholds = (1.0, 3.0, 10.0, 20.0)
    rows = [("random matches", *(f"{threshold:g} px" for threshold in thresholds))]
    for count in (20, 30, 50, 100, 500, 2_000, 20_000):
        trials = max(seeds, seeds * 200 // count)
        cells = (f"{false_poses(trials, count, one)} of {trials}" for one in thresholds)
        rows.append((str(count), *cells))
    return _markdown(rows)


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


@dataclass(frozen=True)
class Compared:
    """One set of matches through this package's pose stage and through plain OpenCV."""

    matches: int
    seconds: float  # CPU time
    errors: Errors
    opencv_seconds: float
    opencv_errors: Errors


def compare(matches: Matches, truth: Truth, options: EstimationOptions) -> Compared:
    """Estimate the pose of one pair by both, one after the other."""
    start = time.process_time()
    pose = estimate_pose(matches, truth.camera1, truth.camera2, options)
    middle = time.process_time()
    found = opencv_pose(matches, truth, options)
    end = time.process_time()
    other = (np.inf, np.inf)
    if found is not None and truth.R is not None and truth.t is not None:
        R, t = found
        other = rotation_error_deg(R, truth.R), translation_error_deg(t, truth.t)
    ours = pose_errors(pose, truth.R, truth.t)
    return Compared(len(matches), middle - start, ours, end - middle, other)


def opencv_pose(
    matches: Matches, truth: Truth, options: EstimationOptions
) -> tuple[np.ndarray, np.ndarray] | None:
    """R (3, 3) and t (3,) by `cv2.findEssentialMat` and `cv2.recoverPose`, None if they fail.

    The best by inliers of `options.runs` calls of RANSAC, of at most `options.iterations` each, by
    the same threshold as the pose stage. OpenCV draws the same samples for the same order of
    points, so that each call permutes them.
    """
    problem = TwoViewProblem.of(matches, truth.camera1, truth.camera2, options)
    points1, points2 = problem.points1, problem.points2
    if len(problem) < MINIMAL:
        return None
    best: tuple[int, np.ndarray, np.ndarray] | None = None
    rng = np.random.default_rng(options.seed)
    for _ in range(options.runs):
        order = rng.permutation(len(problem))
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
            mask = np.zeros((len(problem), 1), np.uint8)
            mask[order] = inliers
            best = int(inliers.sum()), E, mask
    if best is None:
        return None
    _, R, t, _ = cv2.recoverPose(best[1], points1, points2, np.eye(3), mask=best[2])
    return R, t[:, 0]


def comparison_table(methods: Sequence[tuple[str, Sequence[Compared]]], estimator: str) -> str:
    """For each method both estimators' medians over its pairs, mean CPU seconds and their ratio."""
    rows = [("matches of", "mean", "estimator", "s/pair", "R med", "t med", "time")]
    for name, compared in methods:
        matches = f"{np.mean([one.matches for one in compared]):.0f}"
        other = float(np.mean([one.opencv_seconds for one in compared]))
        for label, seconds, errors in (
            (estimator, [one.seconds for one in compared], [one.errors for one in compared]),
            ("findEssentialMat", [other], [one.opencv_errors for one in compared]),
        ):
            mean, (R, t) = float(np.mean(seconds)), np.median(errors, axis=0)
            ratio = "1" if label == "findEssentialMat" else f"{mean / other:.3f}"
            rows.append((name, matches, label, f"{mean:.3f}", f"{R:.2f}", f"{t:.2f}", ratio))
    return aligned(rows)


def _markdown(rows: Sequence[Sequence[str]]) -> list[str]:
    """The lines of a table in Markdown."""
    head, *lines = ("| " + " | ".join(row) + " |" for row in rows)
    return [head, "|---|" + "---|" * (len(rows[0]) - 1), *lines]


def _project(points: np.ndarray) -> np.ndarray:
    return (points @ CAMERA.K.T)[:, :2] / points[:, 2:]
