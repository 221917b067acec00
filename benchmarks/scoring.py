"""From the matches of one method on one pair to its record: the work that other processes do."""

import time
from dataclasses import dataclass
from typing import Generic

import numpy as np

from dgc_pose.benchmarks.metrics import folded, median_and_mean, true_fundamental
from dgc_pose.benchmarks.posed_pairs import Truth
from dgc_pose.benchmarks.scores import Score, make_score
from dgc_pose.cameras.camera import Camera
from dgc_pose.estimation import EstimationOptions, estimate_pose
from dgc_pose.matches import Matches
from dgc_pose.metrics import ideal_pixels, rotation_error_deg, translation_error_deg

# How a warning of a K that may be wrong begins
_DOUBTS = ("the matches suggest f", "K1 ", "K2 ")


@dataclass(frozen=True)
class MatchedPair(Generic[Score]):
    """A pair matched by one method: all that a record is made from."""

    kind: type[Score]
    method: str
    truth: Truth
    cameras: tuple[Camera, Camera]  # that the estimation gets
    matches: Matches
    map_matches: Matches | None  # see `estimate_pose`
    everywhere_px: tuple[float, float]  # median and mean D_e over all pixels
    options: EstimationOptions  # with the seed of the pair
    match_seconds: float


def score(pair: MatchedPair[Score]) -> Score:
    """Estimate the pose of a pair and compare it with the true one."""
    truth, matches, options = pair.truth, pair.matches, pair.options
    start = time.process_time()
    pose = estimate_pose(matches, *pair.cameras, options, map_matches=pair.map_matches)
    seconds = time.process_time() - start
    assert truth.R is not None and truth.t is not None
    rotation = translation = np.inf
    if pose.success and pose.R is not None and pose.t is not None:  # it counts only as a whole
        rotation = rotation_error_deg(pose.R, truth.R)
        translation = translation_error_deg(pose.t, truth.t)
    check = None if pose.evidence is None else pose.evidence.focal_check
    confident = epipolar_errors(truth, matches.points1, matches.points2)
    focal: dict[str, float] = {}  # error of ln f and its expected deviation, NaN without a pose
    for n, camera, true in ((1, pose.camera1, truth.camera1), (2, pose.camera2, truth.camera2)):
        error = np.nan if camera is None else float(np.log(camera.focal / true.focal))
        focal |= {f"focal{n}_error": error}
        focal |= {f"focal{n}_std": np.nan if camera is None else camera.focal_std}
    values = {
        **truth.ids,
        "method": pair.method,
        "true_rotation_deg": rotation_error_deg(truth.R, np.eye(3)),
        "true_baseline_mm": float(np.linalg.norm(truth.t)),
        "status": pose.status,
        "success": pose.success,
        "num_matches": pose.num_matches,
        "num_inliers": pose.num_inliers,
        "inlier_ratio": pose.inlier_ratio,
        "rotation_error_deg": rotation,
        "translation_error_deg": translation,
        "translation_folded_deg": folded(translation),
        "rotation_90_deg": _number(pose.rotation_error_90_deg),
        "translation_90_deg": _number(pose.translation_error_90_deg),
        "probability": _number(pose.probability),
        **focal,
        "focal_ratio": np.nan if check is None else check.factor,
        "focal_ratio_std": np.nan if check is None else check.std,
        "doubts_camera": any(warning.startswith(_DOUBTS) for warning in pose.warnings),
        "epipolar_all_px": pair.everywhere_px[0],
        "epipolar_confident_px": confident[0],
        "epipolar_all_mean_px": pair.everywhere_px[1],
        "epipolar_confident_mean_px": confident[1],
        "match_seconds": pair.match_seconds,
        "estimate_seconds": seconds,
    }
    return make_score(pair.kind, values)


def epipolar_errors(truth: Truth, points1: np.ndarray, points2: np.ndarray) -> tuple[float, float]:
    """Median and mean D_e of matches (..., 2)."""
    assert truth.R is not None and truth.t is not None
    F = true_fundamental(truth.camera1, truth.camera2, truth.R, truth.t)
    ideal1, ideal2 = ideal_pixels(points1, truth.camera1), ideal_pixels(points2, truth.camera2)
    return median_and_mean(ideal1, ideal2, F)


def pair_seed(seed: int, *words: int) -> int:
    """A seed for each pair, the same whatever is estimated before it and in which process."""
    return int(np.random.SeedSequence([seed, *words]).generate_state(1)[0])


def _number(value: float | None) -> float:
    return np.nan if value is None else value
