"""The poses that explain the matches: samples of RANSAC, the refined best, and its competitors.

- The homography of a plane has two poses (Longuet-Higgins 1986).
- Where structure repeats, some matches agree on a pose one period off. RANSAC searches the outliers
  of the first pose for a second one.
- From afar, a scene and its relief turned inside out look alike, with opposite rotations of the
  camera (the bas-relief, or Necker, reversal).

The poses of a plane have nearly the same inliers, so the inlier counts do not show which is right.
The likelihood of all matches shows it better. Errors of neighbouring matches are correlated, so the
log-likelihood is divided by the square root of the number of inliers.
"""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace

import numpy as np

from dgc_pose.estimation.camera_changes import turning
from dgc_pose.estimation.camera_fit import SEARCH_RUNS, JointFit, JointPose, joint_pose
from dgc_pose.estimation.evidence import around_plane
from dgc_pose.estimation.intrinsics_prior import pair_with_parameters
from dgc_pose.estimation.model_comparison import likeliest_model
from dgc_pose.estimation.model_fit import ModelFit, assumed_fit
from dgc_pose.estimation.probability import ProbabilityModel, choice_shares, shipped_models, utility
from dgc_pose.estimation.problem import MIN_MATCHES, Hypothesis, TwoViewProblem, pose_loss_width
from dgc_pose.estimation.robust_fit import (
    PLANAR_SHARE,
    best_planar,
    fit_plane,
    planar_hypotheses,
    refine,
    refit,
    sample,
)
from dgc_pose.estimation.still_camera import StillCamera, turned_camera, zoomed_camera
from dgc_pose.geometry.epipolar import depths, homogeneous, sampson_distance
from dgc_pose.matches import Matches

# Least share of the first one's inliers that another motion has: on a plane (docs/experiments.md),
# with fitted cameras, and with known cameras.
_MIN_SECOND_SHARE_OF_PLANE = 0.1
_MIN_SECOND_SHARE_FITTED = 0.3
_MIN_SECOND_SHARE = 0.5
LIKELY_SHARE = 0.75  # of the first one's inliers: another pose explains the matches as well
_MIN_REFINED_SHARE = 0.3  # of the first one's inliers: another pose is refined
_MAX_DEPTH = 1e6  # in baselines: beyond, there is no parallax to mirror
_MAX_ERROR = 3.0  # thresholds; larger errors, and points behind a camera, count as this
_SAME_TURN = 0.95  # of the matches that another fit explains: the turn that is fitted is as good
_MOST_STILL = 0.6  # share of the matches that a turn explains up to which cameras are compared
_MIN_PLANAR_SHARE = 0.5  # of the inliers on a homography: its poses compete


@dataclass(frozen=True, eq=False)
class Candidates:
    """The poses that explain the matches, and the data to compare them."""

    problem: TwoViewProblem  # normalised by the cameras of the model
    map_problem: TwoViewProblem | None  # of an even sample of the dense map
    fitted: bool  # whether the cameras were fitted
    model: ModelFit  # its cameras have the fitted focal lengths
    hypotheses: Sequence[Hypothesis]  # the likeliest first
    homography_ratio: float  # share of the best one's inliers that one homography explains
    around_plane: float  # how much around this plane contradicts the pose; 0 without a plane
    second: Hypothesis | None  # another motion, among the outliers of the likeliest
    still: StillCamera  # the motion without a translation
    logistic: ProbabilityModel | None  # None if none is fitted for such matches


def candidates(
    stated: TwoViewProblem, map_matches: Matches | None = None, *, fit_cameras: bool = True
) -> Candidates | None:
    """The poses that explain the matches; None if RANSAC finds no essential matrix.

    stated: the matches, normalised by the stated cameras. See `estimate_pose` for the others.
    """
    options = stated.options
    if fit_cameras:
        turned, problem, model, runs = _runs_by_model(stated)
    else:
        problem = stated
        model = assumed_fit(stated.cameras)
        runs = sample(stated)
        turned = turned_camera(stated)
    if not runs:
        return None
    fitted = fit_cameras and not all(camera.exact for camera in model.cameras)
    map_problem = None
    if map_matches is not None:
        # A threshold in pixels applies to the matches, not to the map.
        map_options = replace(options, threshold_px=None)
        map_problem = TwoViewProblem.of(map_matches, *model.cameras, map_options)
    logistic = shipped_models().model(
        stated.matches.weights,
        key_points=stated.matches.key_points,
        with_map=bool(map_problem),
        fitted=fitted and any(camera.focal_std for camera in model.cameras),
    )

    first = _refined(problem, runs[0])
    homography_ratio, H = fit_plane(problem, first)
    on_plane = homography_ratio >= PLANAR_SHARE
    if on_plane and H is not None:
        first = best_planar(problem, first, H, options.refine)
    if options.refine:
        first = refit(problem, first, adapt_width=True)
    if homography_ratio < _MIN_PLANAR_SHARE:
        H = None
    share = _MIN_SECOND_SHARE_FITTED if fitted else _MIN_SECOND_SHARE
    share = _MIN_SECOND_SHARE_OF_PLANE if on_plane else share
    left = _left_over(problem, first, share)
    others = competitors(problem, first, [*runs, *left], H)
    hypotheses = compared(problem, first, others, map_problem)
    hypotheses = ranked(hypotheses, None if logistic is None else logistic.choice)

    best = hypotheses[0]
    if best.inliers is not first.inliers:
        left = _left_over(problem, best, share)
    second = _second_motion(problem, best, left, share * best.num_inliers)
    still = _still_camera(stated, turned, problem, best)
    around = around_plane(problem, best, H) if on_plane and H is not None else 0.0
    return Candidates(
        *(problem, map_problem, fitted, model, hypotheses, homography_ratio, around, second, still),
        logistic,
    )


def _still_camera(
    stated: TwoViewProblem, turned: StillCamera, problem: TwoViewProblem, best: Hypothesis
) -> StillCamera:
    """The motion without a translation that explains most matches. turned: by a turn. problem:
    normalised by the cameras of the pose `best`."""
    if all(camera.exact for camera in stated.cameras):
        return turned
    explained = np.isin(stated.index, problem.index[best.inliers])
    zoomed = zoomed_camera(stated.subset(explained))
    if zoomed.is_turn and turned.count >= _SAME_TURN * zoomed.count:
        return turned  # whose error is known
    return max(zoomed, turned, key=lambda still: still.count)


def _refined(problem: TwoViewProblem, run: Hypothesis) -> Hypothesis:
    return refine(problem, run) if problem.options.refine else run


def _runs_by_model(
    stated: TwoViewProblem,
) -> tuple[StillCamera, TwoViewProblem, ModelFit, list[Hypothesis]]:
    """RANSAC with the likeliest camera model, fitted if the cameras are not exact. A camera that
    only turned shows no other cameras.

    Returns the turn that explains most matches; the problem, normalised by the model's cameras; the
    model; and the hypotheses of the runs, with most inliers first; no hypotheses if there is no
    essential matrix.
    """
    turned = turned_camera(stated.with_cameras(turning(stated.cameras), stated.threshold_px))
    joint = JointFit(stated)
    runs = list[Hypothesis]()
    if len(joint.prior):
        pose = joint_pose(joint)
    elif runs := sample(stated):
        best = _refined(stated, runs[0])
        pose = JointPose(best.R, best.t, np.zeros(0))
    else:
        pose = None
    if pose is None:
        return turned, stated, assumed_fit(stated.cameras), []
    is_still = turned.count > _MOST_STILL * len(stated)
    model = assumed_fit(stated.cameras, pose) if is_still else likeliest_model(stated, pose)
    is_assumed = model.model.name == "assumed"
    if is_assumed and runs:
        return turned, stated, model, runs
    if not is_assumed and model.pose is not None:
        joint = JointFit(stated.with_cameras(model.cameras))
        pose = joint.fitted(model.pose)
    cameras = pair_with_parameters(joint.problem.cameras, joint.parameters(pose))
    problem = stated.with_cameras(cameras)
    model = replace(model, cameras=cameras)
    runs = sample(problem, max(1, stated.options.runs - SEARCH_RUNS))
    runs = [Hypothesis.of_pose(problem, pose.R, pose.t), *runs]
    return turned, problem, model, sorted(runs, key=lambda run: -run.num_inliers)


def _left_over(problem: TwoViewProblem, pose: Hypothesis, share: float) -> list[Hypothesis]:
    """The hypothesis, over all matches, of a run on the outliers of a pose; none if the outliers
    are too few both for another motion (`share` of the inliers) and for a competitor."""
    left = problem.subset(~pose.inliers)
    least = min(_MIN_REFINED_SHARE * pose.num_in_front, share * pose.num_inliers)
    if len(left) < max(MIN_MATCHES, least):
        return []
    return [Hypothesis.of_pose(problem, run.R, run.t) for run in sample(left, 1)]


def _second_motion(
    problem: TwoViewProblem, first: Hypothesis, runs: Sequence[Hypothesis], least: float
) -> Hypothesis | None:
    """Another motion, from the runs on the outliers of a hypothesis, refined on these outliers;
    None if it has fewer than `least` inliers among them."""
    left = problem.subset(~first.inliers)
    if not runs or len(left) < least:
        return None
    second = _refined(left, Hypothesis.of_pose(left, runs[0].R, runs[0].t))
    if second.is_among([first]) or second.num_in_front < least:
        return None
    return Hypothesis.of_pose(problem, second.R, second.t)


def competitors(
    problem: TwoViewProblem, first: Hypothesis, runs: Sequence[Hypothesis], H: np.ndarray | None
) -> list[Hypothesis]:
    """Refined hypotheses more than 10 degrees from the first and from each other, with most inliers
    in front of both cameras first.

    runs: the hypotheses of the runs. H: homography (3, 3) of a plane. Before refinement each has at
    least 0.3 of the first one's inliers.
    """
    least = max(_MIN_REFINED_SHARE * first.num_in_front, 1)
    distinct = [first]
    for candidate in (*runs, *([] if H is None else planar_hypotheses(problem, H))):
        if candidate.num_in_front < least or candidate.is_among(distinct):
            continue
        # Refinement may turn a bad fit of a known pose into that pose.
        refined = _refined(problem, candidate)
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
    units = [ray / np.linalg.norm(ray) for ray in (middle, pose.R @ middle + pose.t)]
    M1, M2 = (np.eye(3) - 2 * np.outer(unit, unit) for unit in units)
    return Hypothesis.of_pose(problem, M2 @ pose.R @ M1, -M2 @ pose.t)


def compared(
    problem: TwoViewProblem,
    first: Hypothesis,
    others: Sequence[Hypothesis],
    map_problem: TwoViewProblem | None,
) -> list[Hypothesis]:
    """All hypotheses with their likelihoods. The likely ones among the others get their last fit,
    if this does not lead to another pose of the list.

    first: has most inliers; its errors show how accurate the matches are. map_problem: an even
    sample of the dense map.
    """
    inliers = problem.subset(first.inliers)
    width = pose_loss_width(inliers, first.R, first.t) if len(inliers) else problem.threshold
    largest = _MAX_ERROR * problem.threshold
    root = math.sqrt(max(first.num_in_front, 1))
    least = LIKELY_SHARE * first.num_in_front
    result: list[Hypothesis] = []
    for number, unfitted in enumerate((first, *others)):
        pose = unfitted
        likely = number == 0 or unfitted.num_in_front >= least
        if likely and number and problem.options.refine:
            fitted = refit(problem, pose, adapt_width=True)
            # A fit may lead to another hypothesis, or to the pose with t reversed.
            if fitted.num_in_front >= least and not fitted.is_among([*result, *others[number:]]):
                pose = fitted
        error = sampson_distance(problem.points1, problem.points2, pose.E)
        error = np.where(pose.in_front, np.minimum(error, largest), largest)
        # The log-likelihood of a Cauchy distribution, cut off, up to a constant.
        likelihood = float((-np.log1p((error / width) ** 2)).sum()) / root
        agreement = None if map_problem is None else pose.agreement(map_problem)
        result.append(replace(pose, likely=likely, likelihood=likelihood, map_agreement=agreement))
    return result


def ranked(among: Sequence[Hypothesis], weights: Mapping[str, float] | None) -> list[Hypothesis]:
    """Hypotheses with their shares, the likeliest first; unchanged without weights.

    weights: log-odds per unit of each of `CHOICE_FEATURES`, and the lapse of `choice_shares`.
    """
    if weights is None:
        return list(among)
    odds = [
        utility(h.likelihood, h.map_agreement, weights) if h.likely else -math.inf for h in among
    ]
    shares = choice_shares(odds, weights["lapse"]).tolist()
    valued = [replace(h, share=share) for h, share in zip(among, shares, strict=True)]
    return sorted(valued, key=lambda h: -h.share)
