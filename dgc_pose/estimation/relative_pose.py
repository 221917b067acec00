"""From matches and cameras to a relative pose, or to the reason why there is none."""

from __future__ import annotations

from functools import partial

import numpy as np

from dgc_pose.camera import Camera
from dgc_pose.estimation.covariance import pose_covariance
from dgc_pose.estimation.evidence import gather
from dgc_pose.estimation.model import Model
from dgc_pose.estimation.options import EstimationOptions
from dgc_pose.estimation.plane import best_planar_model, planar_share
from dgc_pose.estimation.problem import TwoViewProblem
from dgc_pose.estimation.ransac import best_model
from dgc_pose.estimation.refine import refine, refit
from dgc_pose.estimation.result import POSE_STATUSES, RelativePose
from dgc_pose.estimation.verdict import judge
from dgc_pose.matches import Matches
from dgc_pose.options import check_type

_DEFAULTS = EstimationOptions()


def estimate_pose(
    matches: Matches, camera1: Camera, camera2: Camera, options: EstimationOptions = _DEFAULTS
) -> RelativePose:
    """The pose x2 = R x1 + t of camera 2 relative to camera 1, translation up to scale.

    `TwoViewProblem.of` describes how matches and threshold are normalised. The same seed gives the
    same answer to the bit. Raises InputError if `matches` is not Matches.
    """
    check_type(options, EstimationOptions, "options")
    check_type(camera1, Camera, "camera1")
    check_type(camera2, Camera, "camera2")
    problem = TwoViewProblem.of(matches, camera1, camera2, options)
    inliers = np.zeros(len(matches), dtype=bool)
    no_model = partial(
        RelativePose, inliers=inliers, num_matches=len(problem), warnings=problem.warnings
    )
    if len(problem) < options.verdict.min_matches:
        reason = f"only {len(problem)} matches; a verdict needs {options.verdict.min_matches}"
        return no_model("too_few_matches", reason)
    sampled = best_model(problem, options)
    if sampled is None:
        return no_model("no_model", f"no essential matrix was found for {len(problem)} matches")

    model, homography_ratio = _refined(problem, sampled, options)
    covariance = pose_covariance(problem, model)
    evidence = gather(problem, model, homography_ratio, covariance)
    verdict = judge(evidence, options.verdict)

    inliers[problem.index] = model.inliers
    has_pose = verdict.status in POSE_STATUSES
    rotation = evidence.rotation if verdict.status == "rotation_only" else None
    return RelativePose(
        status=verdict.status,
        reason=verdict.reason,
        inliers=inliers,
        num_matches=len(problem),
        R=model.R if has_pose else rotation,
        t=model.t if has_pose else None,
        covariance=covariance if has_pose else None,
        evidence=evidence,
        warnings=problem.warnings + verdict.warnings,
    )


def _refined(
    problem: TwoViewProblem, model: Model, options: EstimationOptions
) -> tuple[Model, float]:
    """The refined model, and the share of inliers that one homography explains."""
    if options.refine:
        model = refine(problem, model)
    share, H = planar_share(problem, model)
    if H is not None and share >= options.verdict.planar_share:
        model = best_planar_model(problem, model, H, options.refine)
    if options.refine:
        model = refit(problem, model, adapt_scale=True)
    return model, share
