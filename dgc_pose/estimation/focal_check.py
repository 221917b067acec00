"""Whether the matches contradict the focal lengths of cameras that are exact.

Their pose and a factor of both focal lengths are fitted together. Where the matches determine the
focal length at all, the fit leads from a wrong one to the right one; where it does not, the
six-point solver has a better start.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import replace

import numpy as np

from dgc_pose.cameras.camera import Camera
from dgc_pose.estimation.camera_fit import LIMITS, JointFit, JointPose, solved_start
from dgc_pose.estimation.covariance import error_radius_deg
from dgc_pose.estimation.evidence import FocalCheck
from dgc_pose.estimation.hypothesis import Hypothesis, pose_loss_width
from dgc_pose.estimation.options import EstimationOptions
from dgc_pose.estimation.probability import CONTRADICTED_LOG_ODDS, is_contradicted
from dgc_pose.estimation.problem import TwoViewProblem
from dgc_pose.estimation.robust_fit import draw
from dgc_pose.matches import Matches

_STD = 0.5  # of ln f: a focal length that is hardly known
_CALIBRATION = 1.5  # of the factor's deviation over the raw one: docs/experiments.md
_CENTRE_STD = 0.005  # of the principal point, over the focal length
_UNCERTAIN_STD = 0.1  # standard deviation of ln f, beyond which there is a warning
_EXPLAINED_SHARE = 0.8  # share of inliers beyond which no other focal length explains many more
_MORE = 1.2  # of the inliers that another focal length must have to be a start
_SAMPLED = 400  # matches that are fitted first
AGREEING_LOG_FOCAL = 0.05  # of ln f: if these suggest no more, no others are fitted


def check_focals(
    problem: TwoViewProblem,
    first: Hypothesis,
    matches: Matches,
    cameras: tuple[Camera, Camera],
    options: EstimationOptions,
    *,
    is_plane: bool = False,
) -> FocalCheck | None:
    """The factor of the focal lengths that the matches suggest; None if they do not determine any.

    problem: of the matches, normalised by the cameras. first: the pose that these give. is_plane:
    whether its inliers lie on a plane, which poses of any focal length explain: then a factor
    counts that makes the matches far likelier alone.
    """
    loose1, loose2 = (
        replace(c, focal_std=_STD, centre_std=_CENTRE_STD * c.focal, identity="both")
        for c in cameras
    )
    joint = JointFit(problem, (loose1, loose2))
    stated = JointPose(first.R, first.t, np.zeros(len(joint.prior)))
    other = None
    if first.num_in_front < _EXPLAINED_SHARE * len(problem):
        # The pose of a wrong K may be a local minimum.
        other = solved_start(joint, options, options.seed)
    if other is not None and joint.inliers_in_front(other).sum() >= _MORE * first.num_in_front:
        pose = joint.fitted(other)
    else:
        # K is right as a rule, which some of the matches show.
        some = draw(problem, problem.seed, _SAMPLED)
        pose = replace(joint, problem=some).fitted(stated, LIMITS[:1])
        if abs(joint.parameters(pose)[0]) >= AGREEING_LOG_FOCAL:
            pose = joint.fitted(pose)
    width = pose_loss_width(problem.subset(first.inliers), first.R, first.t)
    log_odds = joint.log_likelihood(pose, width) - joint.log_likelihood(stated, width)
    if is_plane and log_odds < CONTRADICTED_LOG_ODDS:
        return None
    covariances = joint.covariance(pose, matches, options)
    if covariances is None:
        return None
    of_pose, of_cameras = covariances
    return FocalCheck(
        math.exp(joint.parameters(pose)[0]),
        _CALIBRATION * math.sqrt(of_cameras[0, 0]),
        first.angle_to(pose.R, pose.t),
        max(error_radius_deg(of_pose[k : k + 3, k : k + 3]) for k in (0, 3)),
        log_odds,
    )


def focal_warnings(
    stated: Sequence[Camera], fitted: Sequence[Camera], check: FocalCheck | None
) -> tuple[str, ...]:
    """Warnings about the focal lengths, each a line.

    stated: the cameras before the estimation; fitted: those of the pose, with the standard
    deviations that are left; check: of exact cameras.
    """
    contradicted: dict[str, None] = {}
    sources = {"given": "K", "exif": "EXIF"}
    for before, after in zip(stated, fitted, strict=True):
        f, std, allowed, log_odds = after.focal, after.focal_std, before.focal_std, 0.0
        if check is not None:
            f, std, log_odds = check.factor * before.focal, check.std, check.log_odds
            allowed = std
        source = sources.get(before.focal_source)
        if source and is_contradicted(f / before.focal, allowed, log_odds):
            text = f"f = {f:.0f} +- {std * f:.0f} px, and {source} says {before.focal:.0f}"
            contradicted[text] = None
    if contradicted:
        return (f"the matches suggest {'; '.join(contradicted)}",)
    loose = dict.fromkeys(
        f"f = {camera.focal:.0f} px within {100 * camera.focal_std:.0f} %"
        for camera in fitted
        if camera.focal_std > _UNCERTAIN_STD
    )
    return (f"the matches hardly tell the focal length: {'; '.join(loose)}",) if loose else ()
