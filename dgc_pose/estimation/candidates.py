"""The poses that explain the matches: samples of RANSAC, the refined best, and its competitors."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np

from dgc_pose.cameras.camera import Camera
from dgc_pose.estimation.camera_fit import SEARCH_RUNS, JointFit, joint_pose
from dgc_pose.estimation.camera_model import CameraModel, likeliest_model
from dgc_pose.estimation.competition import compared, competitors, ranked
from dgc_pose.estimation.evidence import measured
from dgc_pose.estimation.hypothesis import Hypothesis
from dgc_pose.estimation.intrinsics_prior import IntrinsicsPrior, pair_with_parameters
from dgc_pose.estimation.options import EstimationOptions
from dgc_pose.estimation.plane import PLANAR_SHARE, best_planar, fit_plane, still_camera
from dgc_pose.estimation.probability import ProbabilityModel, shipped_models
from dgc_pose.estimation.problem import TwoViewProblem
from dgc_pose.estimation.robust_fit import refine, refit, sample
from dgc_pose.estimation.verdict import MIN_MATCHES, by_chance
from dgc_pose.matches import Matches

# Of the inliers, that another motion needs: of a plane's, see docs/experiments.md; and of others',
# where the cameras are fitted.
_MIN_SECOND_SHARE, _MIN_SECOND_SHARE_FITTED = 0.1, 0.3
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

    @property
    def on_plane(self) -> bool:
        """Whether the inliers lie on a plane."""
        return self.homography_ratio >= PLANAR_SHARE


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
    of_stated, model = problem, CameraModel("assumed", stated)
    fitted = fit_cameras and len(IntrinsicsPrior.of(*stated)) > 0
    if fitted:
        problem, model, runs = _fitted_runs(problem, matches, stated, options)
    else:
        runs = sample(problem, options)
    if not runs:
        return None
    map_problem = None
    if map_matches is not None:
        # A threshold in pixels is that of the matches, not of the map.
        map_options = replace(options, threshold_px=None)
        map_problem = TwoViewProblem.of(map_matches, *model.cameras, map_options)
    logistic = shipped_models().model(
        matches.weights,
        key_points=matches.key_points,
        with_map=bool(map_problem),
        fitted=fitted and any(camera.focal_std for camera in stated),
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

    best, second, still = hypotheses[0], None, None
    if on_plane or fitted:
        least = _MIN_SECOND_SHARE if on_plane else _MIN_SECOND_SHARE_FITTED
        second = _second_motion(problem, best, options, least * best.num_inliers)
    if fitted:
        of_inliers = np.isin(of_stated.index, problem.index[best.inliers])
        still = still_camera(of_stated.subset(of_inliers))
    return Candidates(
        *(problem, map_problem, fitted, model, hypotheses, homography_ratio, second, still),
        logistic,
    )


def _fitted_runs(
    problem: TwoViewProblem,
    matches: Matches,
    stated: tuple[Camera, Camera],
    options: EstimationOptions,
) -> tuple[TwoViewProblem, CameraModel, list[Hypothesis]]:
    """RANSAC with the focal lengths of cameras that are not exact among the unknowns.

    Returns the problem, normalised by the cameras; these, by their likeliest model; and the
    hypotheses of the runs, that with most inliers first, none if there is no essential matrix.
    """
    joint = JointFit(problem, stated)
    pose = joint_pose(joint, options)
    if pose is None:
        return problem, CameraModel("assumed", stated), []
    model = likeliest_model(problem, matches, stated, pose, options)
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
