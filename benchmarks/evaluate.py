"""The result of a method on a pair, compared with the truth."""

import time
from dataclasses import replace
from typing import Any

import numpy as np
from numpy.typing import ArrayLike

from dgc_pose.benchmarks.methods import Method
from dgc_pose.benchmarks.posed_pairs import PosedPair
from dgc_pose.cameras.camera import Camera
from dgc_pose.errors import InputError
from dgc_pose.estimation import RelativePose, estimate_pose
from dgc_pose.estimation.camera_texts import is_contradicted
from dgc_pose.estimation.status import STATUSES
from dgc_pose.geometry.epipolar import essential_from_pose
from dgc_pose.matches import Matches
from dgc_pose.matching import CorrespondenceMap, Matcher, select_matches
from dgc_pose.metrics import epipolar_residuals_px, rotation_error_deg, translation_error_deg
from dgc_pose.pose import solve_pair


def score(
    names: tuple[str, str], pair: PosedPair, method: Method, matcher: Matcher
) -> dict[str, Any]:
    """Compare the result of a method on a pair with the truth; return a row of results.csv.

    Errors are infinite without a pose. A value that the method does not give is NaN. D_e is the
    symmetric epipolar distance to the true epipolar lines, in pixels of the images that the method
    gets: over all cells of the dense map (NaN without a map), and over the matches from which the
    pose was estimated (infinite without matches).

    names: the images' names in the list. Raises InputError if the method takes every pixel and its
    matcher makes no map.
    """
    assert pair.R is not None and pair.t is not None
    cameras = method.cameras.cameras(pair)
    pose, matches, dense, match_seconds = _solved(pair, cameras, method, matcher)
    everywhere_px = (np.nan, np.nan)
    if dense is not None:
        everywhere_px = epipolar_errors(pair, dense.map, dense.grid)
    confident_px = epipolar_errors(pair, matches.points1, matches.points2)
    rotation = translation = np.inf
    if pose.success and pose.R is not None and pose.t is not None:  # R without t is a failure
        rotation = rotation_error_deg(pose.R, pair.R)
        translation = translation_error_deg(pose.t, pair.t)
    focal_errors = [np.nan, np.nan]
    focal_stds = [np.nan, np.nan]
    if pose.camera1 is not None and pose.camera2 is not None:
        fitted = (pose.camera1, pose.camera2)
        true = (pair.camera1, pair.camera2)
        focal_errors = [float(np.log(a.focal / b.focal)) for a, b in zip(fitted, true, strict=True)]
        focal_stds = [camera.focal_std for camera in fitted]
    return {
        "method": method.name,
        "image1": names[0],
        "image2": names[1],
        "true_rotation_deg": rotation_error_deg(pair.R, np.eye(3)),
        "status": pose.status,
        "success": pose.success,
        "num_matches": pose.num_matches,
        "num_inliers": pose.num_inliers,
        "inlier_ratio": pose.inlier_ratio,
        "rotation_error_deg": rotation,
        "translation_error_deg": translation,  # 0 to 180
        "translation_folded_deg": folded(translation),
        "match_seconds": match_seconds,  # wall clock of the steps that changed the matches
        "estimate_seconds": pose.seconds["estimate"],  # wall clock of all estimations
        "rotation_90_deg": _number(pose.rotation_error_90_deg),  # expected error
        "translation_90_deg": _number(pose.translation_error_90_deg),
        "probability": _number(pose.probability),  # that R and t are both within 10 degrees
        # ln of the estimated focal length over the true one, and its expected standard deviation
        "focal1_error": focal_errors[0],
        "focal2_error": focal_errors[1],
        "focal1_std": focal_stds[0],  # 0 if the estimation took K as exact
        "focal2_std": focal_stds[1],
        "doubts_camera": doubts_camera(pose, cameras),  # whether a K may be wrong
        "epipolar_all_px": everywhere_px[0],  # medians
        "epipolar_confident_px": confident_px[0],
        "epipolar_all_mean_px": everywhere_px[1],
        "epipolar_confident_mean_px": confident_px[1],
    }


def _solved(
    pair: PosedPair, cameras: tuple[Camera, Camera], method: Method, matcher: Matcher
) -> tuple[RelativePose, Matches, CorrespondenceMap | None, float]:
    """The pose of a pair, its matches, its dense map and the seconds spent on matching."""
    if not method.everywhere:
        found = solve_pair(pair.image1, pair.image2, cameras, matcher, method.estimation)
        seconds = sum(s for step, s in found.pose.seconds.items() if step != "estimate")
        return found.pose, found.matches, found.correspondence_map, seconds
    start = time.perf_counter()
    dense = matcher.match(pair.image1, pair.image2).correspondence_map
    if dense is None:
        raise InputError(f"{method.name}: {matcher.name} makes no dense map")
    every = select_matches(dense, method.matcher.matching, 0.0, 0.0)
    matched = time.perf_counter()
    pose = estimate_pose(every, *cameras, method.estimation)
    pose = replace(pose, seconds={"estimate": time.perf_counter() - matched})
    return pose, every, dense, matched - start


def doubts_camera(pose: RelativePose, cameras: tuple[Camera, Camera]) -> bool:
    """Whether a K may be wrong: it had a warning before the estimation, or the matches contradict
    K or a focal length from EXIF. cameras: before the estimation."""
    if any(camera.focal_source == "given" and camera.warnings for camera in cameras):
        return True
    if pose.evidence is None or not STATUSES[pose.status].shows_cameras:
        return False
    fitted = zip(cameras, (pose.camera1, pose.camera2), strict=True)
    return pose.contradicts_K or any(
        before.focal_source == "exif" and after is not None and is_contradicted(before, after)
        for before, after in fitted
    )


def epipolar_errors(
    pair: PosedPair, points1: np.ndarray, points2: np.ndarray
) -> tuple[float, float]:
    """Median and mean of the distances D_e of matches (..., 2) from the true lines, pixels.

    The distance of a match that is not finite is infinite. Without matches both are infinite.
    """
    assert pair.R is not None and pair.t is not None
    E = essential_from_pose(pair.R, pair.t / np.linalg.norm(pair.t))
    first, second = (
        np.asarray(points, dtype=np.float64).reshape(-1, 2) for points in (points1, points2)
    )
    finite = np.isfinite(first).all(1) & np.isfinite(second).all(1)
    distances = np.full(max(1, len(first)), np.inf)
    cameras = pair.camera1, pair.camera2
    distances[: len(first)][finite] = epipolar_residuals_px(
        first[finite], second[finite], *cameras, E
    )
    return float(np.median(distances)), float(distances.mean())


def folded(error_deg: float) -> float:
    """min(e, 180 - e): the translation error of the matching literature, which ignores t's sign.

    error_deg: degrees in [0, 180]; an infinite error (a failure) stays infinite.
    """
    return min(error_deg, abs(180.0 - error_deg))


def pose_auc(errors: ArrayLike, threshold: float) -> float:
    """Area under the recall curve of pose errors up to a threshold, percent of the full area.

    The curve of the matching literature: straight lines from (0, 0) through the points (e_i, i/N),
    errors in ascending order, constant after the last error below the threshold. The area under
    the curve is exact. Failures have infinite errors and count among the N.

    errors: (N,), N > 0, without NaN, in the unit of the threshold: for each pair max(rotation,
    folded translation).
    """
    values = np.sort(np.asarray(errors, dtype=np.float64))
    below = values[: np.searchsorted(values, threshold)]
    x = np.concatenate(([0.0], below, [threshold]))
    y = np.minimum(np.arange(len(x)), len(below)) / len(values)
    return float(100 * np.sum(np.diff(x) * (y[1:] + y[:-1]) / 2) / threshold)


def _number(value: float | None) -> float:
    return np.nan if value is None else value
