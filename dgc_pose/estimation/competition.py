"""Hypotheses that compete with the first, and which of all is the right one if one of them is.

- Two poses belong to the homography of a plane (Longuet-Higgins 1986).
- Where structure repeats, some matches agree on a pose one period off. Those that the first leaves
  over are searched for a second one.
- Seen from afar, a scene and its relief turned inside out look alike, and the camera seems to have
  rotated the other way (the bas-relief, or Necker, reversal).

The poses of a plane have nearly the same inliers, and their counts do not decide which is right.
The likelihood of all matches does better. Errors of neighbouring matches are alike, so a difference
of log-likelihoods counts by the square root of the number of matches.
"""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import replace

import numpy as np

from dgc_pose.estimation.evidence import map_agreement
from dgc_pose.estimation.hypothesis import Hypothesis, pose_loss_width
from dgc_pose.estimation.options import EstimationOptions
from dgc_pose.estimation.plane import planar_hypotheses
from dgc_pose.estimation.problem import TwoViewProblem
from dgc_pose.estimation.robust_fit import refine, refit, sample
from dgc_pose.geometry.epipolar import homogeneous, sampson_distance
from dgc_pose.geometry.triangulation import depths

CHOICE_FEATURES = ("likelihood", "map_agreement")
LIKELY_SHARE = 0.75  # of the first one's inliers, at which another explains the matches as well
_MIN_REFINED_SHARE = 0.3  # of the first one's inliers, in front of both cameras
_MIN_LEFT = 20  # matches left over that are searched
_MAX_DEPTH = 1e6  # in baselines: beyond, there is no parallax to mirror
_MAX_ERROR = 3.0  # thresholds; larger errors, and points behind a camera, count as this


def competitors(
    problem: TwoViewProblem,
    first: Hypothesis,
    runs: Sequence[Hypothesis],
    H: np.ndarray | None,
    options: EstimationOptions,
) -> list[Hypothesis]:
    """Refined hypotheses more than 10 degrees from the first and from each other, that with most
    inliers in front of both cameras first.

    runs: the hypotheses of the runs. H: homography (3, 3) of a plane. Before refinement each has at
    least 0.3 of the first one's inliers.
    """
    least = max(_MIN_REFINED_SHARE * first.num_in_front, 1)
    candidates = [*runs]
    if H is not None:
        candidates += planar_hypotheses(problem, H)
    left = problem.subset(~first.inliers)
    if len(left) >= max(_MIN_LEFT, least):
        seconds = sample(left, replace(options, runs=1))
        candidates += [Hypothesis.of_pose(problem, second.R, second.t) for second in seconds]
    distinct = [first]
    for candidate in candidates:
        if candidate.num_in_front < least or candidate.is_among(distinct):
            continue
        # A bad fit of a pose that is known becomes that pose.
        refined = refine(problem, candidate) if options.refine else candidate
        if not refined.is_among(distinct):
            distinct.append(refined)
    # The reversal is not refined: the fit could lead back to the first.
    reversal = relief_reversal(problem, first)
    if reversal is not None and not reversal.is_among(distinct):
        distinct.append(reversal)
    return sorted(distinct[1:], key=lambda other: -other.num_in_front)


def relief_reversal(problem: TwoViewProblem, pose: Hypothesis) -> Hypothesis | None:
    """The hypothesis of the scene with its relief turned inside out; None without inliers.

    Each point is mirrored at the plane through the middle of the scene that camera 1 sees face on.
    With the reflections M1 and M2 along the viewing rays to the middle, R becomes M2 R M1, and t
    becomes -M2 t: in images without perspective nothing changes.
    """
    inliers = problem.subset(pose.inliers_in_front)
    depth, _ = depths(inliers.points1, inliers.points2, pose.R, pose.t)
    near = (depth > 0) & (depth < _MAX_DEPTH)
    if not near.any():
        return None
    middle = homogeneous(np.median(inliers.points1[near], axis=0)[None])[0]
    middle = middle * np.median(depth[near])
    M1, M2 = (_reflection(point) for point in (middle, pose.R @ middle + pose.t))
    return Hypothesis.of_pose(problem, M2 @ pose.R @ M1, -M2 @ pose.t)


def _reflection(direction: np.ndarray) -> np.ndarray:
    """The reflection (3, 3) that reverses a direction (3,)."""
    unit = direction / np.linalg.norm(direction)
    return np.eye(3) - 2 * np.outer(unit, unit)


def compared(
    problem: TwoViewProblem,
    first: Hypothesis,
    others: Sequence[Hypothesis],
    map_problem: TwoViewProblem | None,
    options: EstimationOptions,
) -> list[Hypothesis]:
    """Compare the hypothesis with most inliers, whose errors show how accurate the matches are,
    with others; those that are likely have their last fit, if it is still another pose.

    map_problem: an even sample of the dense map.
    """
    inliers = problem.subset(first.inliers)
    width = pose_loss_width(inliers, first.R, first.t) if len(inliers) else problem.threshold
    largest = _MAX_ERROR * problem.threshold
    root = math.sqrt(max(first.num_in_front, 1))
    least = LIKELY_SHARE * first.num_in_front
    result: list[Hypothesis] = []
    for number, unfitted in enumerate((first, *others)):
        pose, likely = unfitted, number == 0 or unfitted.num_in_front >= least
        if likely and number and options.refine:
            fitted = refit(problem, pose, adapt_width=True)
            # A fit may lead to another of the hypotheses, or to that with t reversed.
            if fitted.num_in_front >= least and not fitted.is_among([*result, *others[number:]]):
                pose = fitted
        error = sampson_distance(problem.points1, problem.points2, pose.E)
        error = np.where(pose.in_front, np.minimum(error, largest), largest)
        # Of a Cauchy distribution, cut off, up to a constant.
        likelihood = float((-np.log1p((error / width) ** 2)).sum()) / root
        agreement = None if map_problem is None else map_agreement(map_problem, pose)
        result.append(replace(pose, likely=likely, likelihood=likelihood, map_agreement=agreement))
    return result


def ranked(among: Sequence[Hypothesis], weights: Mapping[str, float] | None) -> list[Hypothesis]:
    """Hypotheses with their shares, the likeliest first; without weights as they are.

    weights: log-odds for a unit of each of `CHOICE_FEATURES`, and the lapse of `choice_shares`.
    """
    if weights is None:
        return list(among)
    odds = [
        utility(h.likelihood, h.map_agreement, weights) if h.likely else -math.inf for h in among
    ]
    shares = choice_shares(odds, weights["lapse"]).tolist()
    valued = [replace(h, share=share) for h, share in zip(among, shares, strict=True)]
    return sorted(valued, key=lambda h: -h.share)


def utility(likelihood: float, map_agreement: float | None, weights: Mapping[str, float]) -> float:
    """The log-odds of a hypothesis, up to a constant of the pair."""
    values = {"likelihood": likelihood, "map_agreement": map_agreement or 0.0}
    return sum(weights[name] * values[name] for name in CHOICE_FEATURES if name in weights)


def choice_shares(utilities: Sequence[float] | np.ndarray, lapse: float = 0.0) -> np.ndarray:
    """Probabilities (K,) of the conditional logit model (McFadden 1974) of utilities (K,), -inf for
    what cannot be chosen. lapse: the probability that any other is right, whatever these state."""
    values = np.asarray(utilities)
    odds = np.exp(values - values.max())
    possible = np.isfinite(values)
    return (1 - lapse) * odds / odds.sum() + lapse * possible / possible.sum()
