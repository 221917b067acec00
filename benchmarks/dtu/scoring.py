"""From the matches of one method on one pair to its row: the work that goes to other processes."""

from __future__ import annotations

import time
from dataclasses import dataclass, replace

import numpy as np

from dgc_pose.benchmarks.dtu.entries import Entry
from dgc_pose.benchmarks.dtu.epipolar import median_and_mean, true_fundamental
from dgc_pose.benchmarks.dtu.records import DtuResult, DtuTiming, Protocol
from dgc_pose.benchmarks.dtu.samples import MatchSample
from dgc_pose.benchmarks.pair_list import Pair
from dgc_pose.benchmarks.pairs import pose_errors
from dgc_pose.estimation import EstimationOptions, estimate_pose
from dgc_pose.matches import Matches
from dgc_pose.metrics import folded, rotation_error_deg

SAMPLE = 60  # matches kept of each pair and method, for the report
_DECIMALS = 4  # of every figure: more would be rounding errors of one library or another


@dataclass(frozen=True)
class Job:
    """All that a row is made from."""

    method: str
    entry: Entry
    protocol: Protocol
    truth: Pair  # cameras of the images that the matches are in
    matches: Matches
    everywhere_px: tuple[float, float]  # median and mean D_e over all pixels
    options: EstimationOptions
    match_seconds: float


@dataclass(frozen=True)
class Scored:
    """A row of each file, and what the report draws."""

    result: DtuResult
    timing: DtuTiming
    sample: MatchSample


def score(job: Job) -> Scored:
    """Estimate the pose of a pair and compare it with the true one."""
    truth, matches = job.truth, job.matches
    place = (job.entry.scene, job.entry.view1, job.entry.view2)
    seed = pair_seed(job.options.seed, *place)
    start = time.process_time()
    pose = estimate_pose(matches, truth.camera1, truth.camera2, replace(job.options, seed=seed))
    seconds = time.process_time() - start
    rotation, translation = pose_errors(pose, truth.R, truth.t)
    confident = median_and_mean(matches.points1, matches.points2, true_fundamental(truth))
    result = DtuResult(
        job.method,
        *place,
        image1=truth.name1,
        image2=truth.name2,
        protocol=job.protocol,
        true_rotation_deg=_rounded(rotation_error_deg(truth.R, np.eye(3))),
        true_baseline_mm=_rounded(float(np.linalg.norm(truth.t))),
        overlap=_rounded(job.entry.overlap),
        status=pose.status,
        success=pose.success,
        num_matches=pose.num_matches,
        num_inliers=pose.num_inliers,
        inlier_ratio=_rounded(pose.inlier_ratio),
        rotation_error_deg=_rounded(rotation),
        translation_error_deg=_rounded(translation),
        translation_folded_deg=_rounded(folded(translation)),
        epipolar_all_px=_rounded(job.everywhere_px[0]),
        epipolar_confident_px=_rounded(confident[0]),
        epipolar_all_mean_px=_rounded(job.everywhere_px[1]),
        epipolar_confident_mean_px=_rounded(confident[1]),
    )
    timing = DtuTiming(
        job.method,
        *place,
        match_seconds=_rounded(job.match_seconds),
        pose_seconds=_rounded(seconds),
    )
    return Scored(result, timing, _sample(matches, pose.inliers, seed))


def pair_seed(seed: int, scene: int, view1: int, view2: int) -> int:
    """A seed for each pair, the same whatever is estimated before it and in which process."""
    return int(np.random.SeedSequence([seed, scene, view1, view2]).generate_state(1)[0])


def _sample(matches: Matches, inliers: np.ndarray, seed: int) -> MatchSample:
    """A few matches at random."""
    finite = np.isfinite(matches.points1).all(1) & np.isfinite(matches.points2).all(1)
    shuffled = np.random.default_rng(seed).permutation(np.flatnonzero(finite))
    chosen = np.sort(shuffled[:SAMPLE])
    return MatchSample(matches.points1[chosen], matches.points2[chosen], inliers[chosen])


def _rounded(value: float) -> float:
    return round(float(value), _DECIMALS)
