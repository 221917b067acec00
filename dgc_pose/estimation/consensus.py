"""Five runs of 1000 iterations: the essential matrix with most inliers over all matches."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from dgc_pose.estimation.backends import MINIMAL, SIDE_BY_SIDE, get_backend
from dgc_pose.estimation.options import EstimationOptions
from dgc_pose.estimation.poselib_backend import refine_pose
from dgc_pose.geometry.epipolar import essential_from_pose, pose_candidates, sampson_distance
from dgc_pose.geometry.homography import fit_homography, homography_poses, transfer_error
from dgc_pose.geometry.triangulation import depths
from dgc_pose.threads import in_threads

_PLANE_LIMIT = 1.75  # a homography's transfer error, over the epipolar threshold
_DEVIATION = 1.4826  # standard deviation of Gaussian noise, over the median of its magnitude
_EFFICIENT = 2.385  # Cauchy loss of 95 % efficiency on Gaussian noise, in standard deviations
_LEAST_SCALE = 0.02  # of the threshold: matches are not believed to be better than that


@dataclass(frozen=True)
class Model:
    """An essential matrix as a pose, and the matches that agree with it."""

    R: np.ndarray  # (3, 3)
    t: np.ndarray  # (3,), unit length
    inliers: np.ndarray  # (N,) bool: Sampson distance below the threshold
    in_front: np.ndarray  # (N,) bool: before both cameras

    @property
    def count(self) -> int:
        return int(self.inliers.sum())

    @property
    def score(self) -> tuple[int, int]:
        """Inliers, and inliers in front of both cameras: more is better."""
        return self.count, int((self.inliers & self.in_front).sum())


def best_model(
    points1: np.ndarray, points2: np.ndarray, threshold: float, options: EstimationOptions
) -> Model | None:
    """The model with most inliers of `options.runs` RANSAC runs, refined where options say so.

    points1, points2: normalised (N, 2); threshold: Sampson distance in the same unit. Each run sees
    at most `options.max_sampled` matches, drawn by its own seed; inliers are counted here, over all
    matches and the same way for every backend. None where no run finds a model.
    """
    if len(points1) < MINIMAL:
        return None
    backend = get_backend(options.estimator)

    def run(seed: int) -> list[np.ndarray]:
        seen = _sample(len(points1), options.max_sampled, seed)
        return backend(
            points1[seen],
            points2[seen],
            threshold=threshold,
            iterations=options.iterations,
            seed=seed,
        )

    seeds = run_seeds(options)
    side_by_side = options.estimator in SIDE_BY_SIDE
    found = in_threads(run, seeds) if side_by_side else [run(seed) for seed in seeds]
    essentials = [E for models in found for E in models]
    if not essentials:
        return None
    counts = [(sampson_distance(points1, points2, E) < threshold).sum() for E in essentials]
    best = model_of_essential(points1, points2, essentials[int(np.argmax(counts))], threshold)
    return refined(points1, points2, best, threshold) if options.refine else best


def _sample(count: int, most: int, seed: int) -> np.ndarray | slice:
    """Which of `count` matches a run sees: `most` of them at random, or all."""
    if count <= most:
        return slice(None)
    return np.random.default_rng(seed).permutation(count)[:most]


def run_seeds(options: EstimationOptions) -> list[int]:
    """A seed for each run, all different, drawn from the one in the options."""
    seeds = np.random.SeedSequence(options.seed).generate_state(options.runs)
    # OpenCV and pycolmap take positive 32-bit seeds.
    return [int(seed) % (2**31 - 1) for seed in seeds]


def model_of_essential(
    points1: np.ndarray, points2: np.ndarray, E: np.ndarray, threshold: float
) -> Model:
    """Of an essential matrix's four poses the one with most inliers in front of both cameras."""
    models = [model_of_pose(points1, points2, R, t, threshold) for R, t in pose_candidates(E)]
    return max(models, key=lambda model: model.score[1])


def model_of_pose(
    points1: np.ndarray, points2: np.ndarray, R: np.ndarray, t: np.ndarray, threshold: float
) -> Model:
    """The matches that agree with a pose."""
    inliers = sampson_distance(points1, points2, essential_from_pose(R, t)) < threshold
    depth1, depth2 = depths(points1, points2, R, t)
    return Model(R, t, inliers, (depth1 > 0) & (depth2 > 0))


def refined(
    points1: np.ndarray, points2: np.ndarray, model: Model, threshold: float, rounds: int = 3
) -> Model:
    """The model after robust least squares on its inliers, again while they change.

    Stops where that would lose more than one inlier in fifty.
    """
    for _ in range(rounds):
        # A match behind a camera is an outlier that happens to lie near its epipolar line.
        kept = model.inliers & model.in_front
        if kept.sum() <= MINIMAL:
            break
        R, t = refine_pose(points1[kept], points2[kept], model.R, model.t, threshold)
        found = model_of_pose(points1, points2, R, t, threshold)
        # The translation's sign does not show in the epipolar error; depths settle it.
        flipped = model_of_pose(points1, points2, R, -t, threshold)
        found = max((found, flipped), key=lambda m: m.score)
        if found.count < 0.98 * model.count:
            break
        done = np.array_equal(found.inliers, model.inliers)
        model = found
        if done:
            break
    return model


def polished(
    points1: np.ndarray, points2: np.ndarray, model: Model, threshold: float, rounds: int = 3
) -> Model:
    """The model after least squares as robust as the inliers' own errors ask for.

    The threshold tells inliers from outliers; most inliers are much better than that, and those
    that are not would pull the pose. Keeps the model where this would lose more than one inlier in
    fifty.
    """
    kept = model.inliers & model.in_front
    if kept.sum() <= MINIMAL:
        return model
    R, t = model.R, model.t
    for _ in range(rounds):
        scale = error_scale(points1[kept], points2[kept], R, t, threshold)
        R, t = refine_pose(points1[kept], points2[kept], R, t, scale)
    found = model_of_pose(points1, points2, R, t, threshold)
    return found if found.count >= 0.98 * model.count else model


def error_scale(
    points1: np.ndarray, points2: np.ndarray, R: np.ndarray, t: np.ndarray, threshold: float
) -> float:
    """Where the Cauchy loss of the Sampson errors of inliers (N, 2) is to flatten, in their unit.

    From the median error, as if most of them were Gaussian; at most the threshold.
    """
    error = sampson_distance(points1, points2, essential_from_pose(R, t))
    scale = _EFFICIENT * _DEVIATION * float(np.median(error))
    return min(max(scale, _LEAST_SCALE * threshold), threshold)


def planar_share(
    points1: np.ndarray, points2: np.ndarray, model: Model, threshold: float, seed: int
) -> tuple[float, np.ndarray | None]:
    """The share of a model's inliers that one homography explains, and that homography.

    A homography answers for both coordinates of the noise of both images, the epipolar constraint
    for one: the same noise needs a limit some 1.75 times as wide.
    """
    kept = model.inliers
    limit = _PLANE_LIMIT * threshold
    H = fit_homography(points1[kept], points2[kept], limit, seed)
    if H is None:
        return 0.0, None
    return float((transfer_error(points1[kept], points2[kept], H) < limit).mean()), H


def best_planar_model(
    points1: np.ndarray,
    points2: np.ndarray,
    model: Model,
    H: np.ndarray,
    threshold: float,
    refine: bool,
) -> Model:
    """The best of a model and the poses that a plane's homography stands for.

    On a plane the five-point solver has a whole family of near solutions; those that the
    homography allows are two.
    """
    models = [model]
    for R, t in homography_poses(H):
        found = model_of_pose(points1, points2, R, t, threshold)
        models.append(refined(points1, points2, found, threshold) if refine else found)
    return max(models, key=lambda m: (m.score[1], m.score[0]))
