"""The loop of every pose benchmark: match the pairs of a data set, estimate, compare."""

import hashlib
import json
import time
from collections.abc import Iterator, Sequence
from dataclasses import asdict, replace
from typing import Any

import numpy as np

from dgc_pose.benchmarks.methods import Method
from dgc_pose.benchmarks.metrics import folded, median_and_mean
from dgc_pose.benchmarks.posed_pairs import ListedPairs, PosedPair, Truth
from dgc_pose.benchmarks.store import PairScore
from dgc_pose.cameras.camera import Camera
from dgc_pose.errors import InputError
from dgc_pose.estimation import RelativePose, estimate_pose
from dgc_pose.estimation.camera_model import OF_STATED, is_contradicted
from dgc_pose.estimation.status import STATUSES
from dgc_pose.geometry.epipolar import essential_from_pose, fundamental_from_essential
from dgc_pose.matches import Matches
from dgc_pose.matching import CorrespondenceMap, Matcher, select_matches
from dgc_pose.metrics import ideal_pixels, rotation_error_deg, translation_error_deg
from dgc_pose.pose import solve_pair


def evaluate(
    pairs: ListedPairs, methods: Sequence[Method], matchers: Sequence[Matcher], first: int = 0
) -> Iterator[list[PairScore]]:
    """For each pair from number `first` on, in order, a record a method.

    matchers: of each method.

    Raises what reading a pair raises.
    """
    for pair in pairs.read(first):
        yield [score(pair, *each) for each in zip(methods, matchers, strict=True)]


def settings(
    pairs: ListedPairs, methods: Sequence[Method], matchers: Sequence[Matcher], device: str
) -> dict[str, Any]:
    """All that the records depend on, for `open_run`."""
    ids = json.dumps([dict(pair_ids) for pair_ids in pairs.ids])
    return {
        "pairs": hashlib.sha256(ids.encode()).hexdigest()[:16],
        "methods": [asdict(method) for method in methods],
        "weights": {
            method.matcher.weights: matcher.fingerprint
            for method, matcher in zip(methods, matchers, strict=True)
            if matcher.fingerprint is not None
        },
        "device": device,
    }


def score(pair: PosedPair, method: Method, matcher: Matcher) -> PairScore:
    """What a method makes of a pair, compared with the truth.

    Raises InputError if it asks for every pixel of a matcher that makes no map.
    """
    truth = pair.truth
    assert truth.R is not None and truth.t is not None
    cameras = method.cameras.cameras(pair)
    pose, matches, dense, match_seconds = _solved(pair, cameras, method, matcher)
    everywhere_px = (np.nan, np.nan)
    if dense is not None:
        everywhere_px = epipolar_errors(truth, dense.map, dense.grid)
    confident_px = epipolar_errors(truth, matches.points1, matches.points2)
    rotation = translation = np.inf
    if pose.success and pose.R is not None and pose.t is not None:  # it counts only as a whole
        rotation = rotation_error_deg(pose.R, truth.R)
        translation = translation_error_deg(pose.t, truth.t)
    focal_errors, focal_stds = [np.nan, np.nan], [np.nan, np.nan]
    if pose.camera1 is not None and pose.camera2 is not None:
        fitted, true = (pose.camera1, pose.camera2), (truth.camera1, truth.camera2)
        focal_errors = [float(np.log(a.focal / b.focal)) for a, b in zip(fitted, true, strict=True)]
        focal_stds = [camera.focal_std for camera in fitted]
    return PairScore(
        **truth.ids,
        method=method.name,
        true_rotation_deg=rotation_error_deg(truth.R, np.eye(3)),
        status=pose.status,
        success=pose.success,
        num_matches=pose.num_matches,
        num_inliers=pose.num_inliers,
        inlier_ratio=pose.inlier_ratio,
        rotation_error_deg=rotation,
        translation_error_deg=translation,
        translation_folded_deg=folded(translation),
        match_seconds=match_seconds,
        estimate_seconds=pose.seconds["estimate"],
        rotation_90_deg=_number(pose.rotation_error_90_deg),
        translation_90_deg=_number(pose.translation_error_90_deg),
        probability=_number(pose.probability),
        focal1_error=focal_errors[0],
        focal2_error=focal_errors[1],
        focal1_std=focal_stds[0],
        focal2_std=focal_stds[1],
        doubts_camera=doubts_camera(pose, cameras),
        epipolar_all_px=everywhere_px[0],
        epipolar_confident_px=confident_px[0],
        epipolar_all_mean_px=everywhere_px[1],
        epipolar_confident_mean_px=confident_px[1],
    )


def _solved(
    pair: PosedPair,
    cameras: tuple[Camera, Camera],
    method: Method,
    matcher: Matcher,
) -> tuple[RelativePose, Matches, CorrespondenceMap | None, float]:
    """The pose of a pair, its matches and the dense map, and the seconds of the matching."""
    if not method.everywhere:
        found = solve_pair(pair.image1, pair.image2, cameras, matcher, method.estimation)
        seconds = sum(s for step, s in found.pose.seconds.items() if step != "estimate")
        return found.pose, found.matches, found.correspondence_map, seconds
    start = time.perf_counter()
    dense = matcher.match(pair.image1, pair.image2).correspondence_map
    if dense is None:
        raise InputError(f"{method.name}: {matcher.name} makes no map")
    every = select_matches(dense, method.matcher.matching, 0.0, 0.0)
    matched = time.perf_counter()
    pose = estimate_pose(every, *cameras, method.estimation)
    pose = replace(pose, seconds={"estimate": time.perf_counter() - matched})
    return pose, every, dense, matched - start


def doubts_camera(pose: RelativePose, cameras: tuple[Camera, Camera]) -> bool:
    """Whether a K may be wrong: there was a warning of it before the estimation, or the matches
    contradict its focal length or that of the EXIF data. cameras: before the estimation."""
    if any(camera.focal_source == "given" and camera.warnings for camera in cameras):
        return True
    if pose.evidence is None or not STATUSES[pose.status].of_cameras:
        return False
    fitted = zip(cameras, (pose.camera1, pose.camera2), strict=True)
    return pose.evidence.camera_model in OF_STATED or any(
        before.focal_source == "exif" and after is not None and is_contradicted(before, after)
        for before, after in fitted
    )


def epipolar_errors(truth: Truth, points1: np.ndarray, points2: np.ndarray) -> tuple[float, float]:
    """Median and mean of the distances D_e of matches (..., 2) from the true lines, pixels."""
    assert truth.R is not None and truth.t is not None
    E = essential_from_pose(truth.R, truth.t / np.linalg.norm(truth.t))
    F = fundamental_from_essential(E, truth.camera1.K, truth.camera2.K)
    ideal1, ideal2 = ideal_pixels(points1, truth.camera1), ideal_pixels(points2, truth.camera2)
    return median_and_mean(ideal1, ideal2, F)


def _number(value: float | None) -> float:
    return np.nan if value is None else value
