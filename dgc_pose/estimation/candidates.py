"""The poses that explain the matches: samples of RANSAC, the refined best, and its competitors.

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
from dataclasses import dataclass, replace

import numpy as np

from dgc_pose.cameras.camera import Camera
from dgc_pose.estimation.camera_fit import SEARCH_RUNS, JointFit, JointPose, joint_pose
from dgc_pose.estimation.camera_model import CameraModel
from dgc_pose.estimation.evidence import map_agreement, measured
from dgc_pose.estimation.hypothesis import Hypothesis, pose_loss_width
from dgc_pose.estimation.intrinsics_prior import pair_with_parameters
from dgc_pose.estimation.model_comparison import likeliest_model
from dgc_pose.estimation.options import EstimationOptions
from dgc_pose.estimation.plane import (
    PLANAR_SHARE,
    best_planar,
    fit_plane,
    planar_hypotheses,
    still_camera,
)
from dgc_pose.estimation.probability import ProbabilityModel, choice_shares, shipped_models, utility
from dgc_pose.estimation.problem import TwoViewProblem
from dgc_pose.estimation.robust_fit import refine, refit, sample
from dgc_pose.estimation.verdict import MIN_MATCHES, by_chance
from dgc_pose.geometry.epipolar import depths, homogeneous, sampson_distance
from dgc_pose.matches import Matches

# Of the inliers, that another motion needs: of a plane's, see docs/experiments.md; of others' where
# the cameras are fitted, and where they are known.
_MIN_SECOND_SHARE_OF_PLANE, _MIN_SECOND_SHARE_FITTED, _MIN_SECOND_SHARE = 0.1, 0.3, 0.5
LIKELY_SHARE = 0.75  # of the first one's inliers, at which another explains the matches as well
_MIN_REFINED_SHARE = 0.3  # of the first one's inliers, in front of both cameras
_MIN_LEFT = 20  # matches left over that are searched
_MAX_DEPTH = 1e6  # in baselines: beyond, there is no parallax to mirror
_MAX_ERROR = 3.0  # thresholds; larger errors, and points behind a camera, count as this
_MIN_PLANAR_SHARE = 0.5  # of inliers that one homography explains, which has poses that compete


@dataclass(frozen=True, eq=False)
class Candidates:
    """The poses that explain the matches, and what they are compared by."""

    problem: TwoViewProblem  # normalised by the cameras
    map_problem: TwoViewProblem | None  # of an even sample of the dense map
    fitted: bool  # whether the cameras were fitted
    model: CameraModel  # whose cameras have the focal lengths that the matches determine
    hypotheses: Sequence[Hypothesis]  # the likeliest first
    homography_ratio: float  # share of the best one's inliers that one homography explains
    second: Hypothesis | None  # another motion, of the matches that the likeliest leaves over
    # Share of inliers that a camera explains which did not move, and its rotation (3, 3); of fitted
    # cameras.
    still: tuple[float, np.ndarray] | None
    logistic: ProbabilityModel | None  # None if none is fitted for such matches


def candidates(
    problem: TwoViewProblem,
    matches: Matches,
    stated: tuple[Camera, Camera],
    options: EstimationOptions,
    map_matches: Matches | None = None,
    *,
    fit_cameras: bool = True,
) -> Candidates | None:
    """The poses that explain the matches; None if RANSAC has no essential matrix.

    problem: of the matches, normalised by the stated cameras. The others are of `estimate_pose`.
    """
    of_stated = problem
    if fit_cameras:
        problem, model, runs = _runs_by_model(problem, matches, stated, options)
    else:
        model, runs = CameraModel("assumed", stated), sample(problem, options)
    if not runs:
        return None
    fitted = fit_cameras and not all(camera.exact for camera in model.cameras)
    map_problem = None
    if map_matches is not None:
        # A threshold in pixels is that of the matches, not of the map.
        map_options = replace(options, threshold_px=None)
        map_problem = TwoViewProblem.of(map_matches, *model.cameras, map_options)
    logistic = shipped_models().model(
        matches.weights,
        key_points=matches.key_points,
        with_map=bool(map_problem),
        fitted=fitted and any(camera.focal_std for camera in model.cameras),
    )

    first = refine(problem, runs[0]) if options.refine else runs[0]
    homography_ratio, H = fit_plane(problem, first)
    on_plane = homography_ratio >= PLANAR_SHARE
    if on_plane and H is not None:
        first = best_planar(problem, first, H, options.refine)
    if options.refine:
        first = refit(problem, first, adapt_width=True)
    if homography_ratio < _MIN_PLANAR_SHARE:
        H = None
    others = competitors(problem, first, runs, H, options)
    hypotheses = compared(problem, first, others, map_problem, options)
    hypotheses = ranked(hypotheses, None if logistic is None else logistic.choice)

    best, still = hypotheses[0], None
    least = _MIN_SECOND_SHARE_FITTED if fitted else _MIN_SECOND_SHARE
    least = _MIN_SECOND_SHARE_OF_PLANE if on_plane else least
    second = _second_motion(problem, best, options, least * best.num_inliers)
    if fitted:
        of_inliers = np.isin(of_stated.index, problem.index[best.inliers])
        still = still_camera(of_stated.subset(of_inliers))
    return Candidates(
        *(problem, map_problem, fitted, model, hypotheses, homography_ratio, second, still),
        logistic,
    )


def _runs_by_model(
    problem: TwoViewProblem,
    matches: Matches,
    stated: tuple[Camera, Camera],
    options: EstimationOptions,
) -> tuple[TwoViewProblem, CameraModel, list[Hypothesis]]:
    """RANSAC, and the cameras by their likeliest model, fitted if they are not exact.

    Returns the problem, normalised by the cameras; these; and the hypotheses of the runs, that with
    most inliers first, none if there is no essential matrix.
    """
    joint, runs = JointFit(problem, stated), list[Hypothesis]()
    if len(joint.prior):
        pose = joint_pose(joint, options)
    elif runs := sample(problem, options):
        best = refine(problem, runs[0]) if options.refine else runs[0]
        pose = JointPose(best.R, best.t, np.zeros(0))
    else:
        pose = None
    if pose is None:
        return problem, CameraModel("assumed", stated), []
    model = likeliest_model(problem, matches, stated, pose, options)
    if model.name == "assumed" and runs:
        return problem, model, runs
    if model.name != "assumed" and model.pose is not None:
        joint = JointFit(TwoViewProblem.of(matches, *model.cameras, options), model.cameras)
        pose = joint.fitted(model.pose)
    model = replace(model, cameras=pair_with_parameters(joint.cameras, joint.parameters(pose)))
    problem = TwoViewProblem.of(matches, *model.cameras, options)
    rest = replace(options, runs=max(1, options.runs - SEARCH_RUNS))
    runs = [Hypothesis.of_pose(problem, pose.R, pose.t), *sample(problem, rest)]
    return problem, model, sorted(runs, key=lambda run: -run.num_inliers)


def _second_motion(
    problem: TwoViewProblem, first: Hypothesis, options: EstimationOptions, least: float
) -> Hypothesis | None:
    """Another motion, found in the matches that a hypothesis leaves over; None if it has fewer
    inliers than `least` among these, or if unrelated images could have as many."""
    left = problem.subset(~first.inliers)
    if len(left) < max(MIN_MATCHES, least):
        return None
    runs = sample(left, replace(options, runs=1))
    if not runs:
        return None
    second = refine(left, runs[0]) if options.refine else runs[0]
    if second.is_among([first]) or second.num_in_front < least:
        return None
    if by_chance(measured(left, second)):
        return None
    return Hypothesis.of_pose(problem, second.R, second.t)


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
