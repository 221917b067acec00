"""Whether the matches contradict the focal lengths of exact cameras.

From the pose that these cameras give, the pose and a factor of both focal lengths are fitted
together. Where the matches determine the focal length at all, the fit leads from a wrong one to the
right one; where it does not, the six-point solver has a better start.
"""

import math
from collections.abc import Sequence
from dataclasses import replace

import numpy as np

from dgc_pose.cameras.camera import Camera
from dgc_pose.estimation.camera_fit import JointFit, JointPose, solved_start
from dgc_pose.estimation.camera_spread import CameraSpread, deviating
from dgc_pose.estimation.covariance import error_radius_deg, pose_covariance
from dgc_pose.estimation.evidence import FocalCheck
from dgc_pose.estimation.hypothesis import Hypothesis
from dgc_pose.estimation.options import EstimationOptions
from dgc_pose.estimation.probability import calibrated_focal_std, is_contradicted
from dgc_pose.estimation.problem import TwoViewProblem
from dgc_pose.matches import Matches

_STD = 0.5  # of ln f: a focal length that is hardly known
_CENTRE_STD = 0.005  # of the principal point, over the focal length
_UNCERTAIN_STD = 0.1  # standard deviation of ln f, beyond which there is a warning
_EXPLAINED = 0.8  # share of inliers beyond which no other focal length explains many more
_MORE = 1.2  # of the inliers that another focal length must have to be a start
_SAMPLED = 400  # matches that are fitted first
_ITERATIONS = 30  # of their fit
_AGREEING = 0.05  # of ln f: if these suggest no more, the focal lengths are right


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
        f, std, allowed = after.focal, after.focal_std, before.focal_std
        if check is not None:
            f, std = check.factor * before.focal, calibrated_focal_std(check.std)
            allowed = std
        source = sources.get(before.focal_source)
        if source and is_contradicted(f / before.focal, allowed):
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


def check_focals(
    problem: TwoViewProblem,
    first: Hypothesis,
    matches: Matches,
    cameras: tuple[Camera, Camera],
    options: EstimationOptions,
) -> FocalCheck | None:
    """The factor of the focal lengths that the matches suggest; None if it is 1 or not determined.

    problem: of the matches, normalised by the cameras. first: the pose that these give.
    """
    loose1, loose2 = (
        replace(
            camera, focal_std=_STD, centre_std=_CENTRE_STD * camera.focal, identity="both cameras"
        )
        for camera in cameras
    )
    spread = CameraSpread.of(loose1, loose2)
    joint = JointFit(problem, spread)
    pose = JointPose(first.R, first.t, np.zeros(len(spread)))
    other = None
    if first.num_in_front < _EXPLAINED * len(problem):
        # The pose of a wrong K may be a local minimum.
        other = solved_start(problem, spread, options, options.seed)
    if other is not None and joint.inliers_in_front(other).sum() >= _MORE * first.num_in_front:
        pose = other
    else:
        pose = _of_sample(joint, pose)
        if abs(joint.deviations(pose)[0]) < _AGREEING:
            return None
    pose = joint.fitted(pose)
    deviations = joint.deviations(pose)
    fitted1, fitted2 = deviating(loose1, deviations[:3]), deviating(loose2, deviations[3:])
    fitted = TwoViewProblem.of(matches, fitted1, fitted2, options)
    refitted = Hypothesis.of_pose(fitted, pose.R, pose.t)
    covariance = pose_covariance(fitted, refitted, CameraSpread.of(fitted1, fitted2))
    if covariance is None:
        return None
    radii = (error_radius_deg(covariance.pose[k : k + 3, k : k + 3]) for k in (0, 3))
    return FocalCheck(
        math.exp(deviations[0]),
        covariance.focal_stds[0],
        first.angle_to(pose.R, pose.t),
        max(radii),
    )


def _of_sample(joint: JointFit, pose: JointPose) -> JointPose:
    """The pose that some of the matches, drawn at random, suggest: K is right as a rule."""
    count = len(joint.problem)
    chosen = np.zeros(count, bool)
    chosen[np.random.default_rng(joint.problem.seed).permutation(count)[:_SAMPLED]] = True
    sample = JointFit(joint.problem.subset(chosen), joint.spread)
    return sample.fitted(pose, rounds=1, iterations=_ITERATIONS)
