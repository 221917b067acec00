"""From matches and cameras to a relative pose, or to the reason why there is none.

`estimate_pose` finds the candidates, measures the uncertainty of the likeliest, and judges it by
the evidence.
"""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from dgc_pose.cameras.camera import Camera
from dgc_pose.estimation.camera_model import model_warnings
from dgc_pose.estimation.candidates import Candidates, candidates
from dgc_pose.estimation.covariance import error_radius_deg
from dgc_pose.estimation.evidence import Evidence, measured
from dgc_pose.estimation.extent import odd_extent
from dgc_pose.estimation.focal_check import focal_warnings
from dgc_pose.estimation.options import EstimationOptions
from dgc_pose.estimation.overlay import are_far, of_the_moving, staying
from dgc_pose.estimation.problem import TwoViewProblem
from dgc_pose.estimation.result import RelativePose
from dgc_pose.estimation.status import STATUSES
from dgc_pose.estimation.uncertainty import Uncertainty, uncertainty
from dgc_pose.estimation.verdict import MIN_MATCHES, judge
from dgc_pose.matches import Matches
from dgc_pose.metrics import rotation_error_deg
from dgc_pose.system.options import check_type

_DEFAULTS = EstimationOptions()
_OF_CAMERAS = ("ok", "planar", "improbable", "undetermined")  # whose matches are evidence of K


def estimate_pose(
    matches: Matches,
    camera1: Camera,
    camera2: Camera,
    options: EstimationOptions = _DEFAULTS,
    *,
    map_matches: Matches | None = None,
    fit_cameras: bool = True,
) -> RelativePose:
    """The pose x2 = R x1 + t of camera 2 relative to camera 1, translation up to scale.

    `TwoViewProblem.of` describes how matches and threshold are normalised. map_matches: an even
    sample of the dense map that the matches come from (`MatchResult.map_matches`), as evidence for
    the probability. fit_cameras: whether the focal lengths of cameras that are not exact are
    fitted; without, their deviations only widen the errors. The warnings of the cameras are among
    those of the pose. The same seed gives the same answer to the bit. Raises InputError, naming the
    argument, for one of another type, and for points outside their camera's size.
    """
    check_type(matches, Matches, "matches")
    check_type(options, EstimationOptions, "options")
    check_type(camera1, Camera, "camera1")
    check_type(camera2, Camera, "camera2")
    odd = odd_extent(matches.points1, camera1, 1) + odd_extent(matches.points2, camera2, 2)
    cameras, stay = (camera1, camera2), staying(matches, camera1, camera2)
    pose = None
    if stay.any():
        of_map = map_matches and map_matches.subset(~staying(map_matches, *cameras))
        moving = _estimated(matches.subset(~stay), cameras, options, of_map, fit_cameras)
        pose = None if are_far(moving, camera1) else of_the_moving(moving, stay)
    if pose is None:
        pose = _estimated(matches, cameras, options, map_matches, fit_cameras)
    return replace(pose, warnings=tuple(dict.fromkeys((*pose.warnings, *odd))))


def _estimated(
    matches: Matches,
    stated: tuple[Camera, Camera],
    options: EstimationOptions,
    map_matches: Matches | None,
    fit_cameras: bool,
) -> RelativePose:
    """`estimate_pose` of matches of one motion."""
    problem = TwoViewProblem.of(matches, *stated, options)
    warnings = tuple(dict.fromkeys((*(w for c in stated for w in c.warnings), *problem.warnings)))
    inliers = np.zeros(len(matches), dtype=bool)
    for number, camera in enumerate(stated, start=1):
        if camera.projection:
            reason = f"image {number} is {camera.projection}, by its XMP data"
            return RelativePose("panorama", reason, inliers, len(problem), warnings=warnings)
    if len(problem) < MIN_MATCHES:
        reason = f"only {len(problem)} matches; a verdict needs {MIN_MATCHES}"
        return RelativePose("too_few_matches", reason, inliers, len(problem), warnings=warnings)
    found = candidates(problem, matches, stated, options, map_matches, fit_cameras=fit_cameras)
    if found is None:
        reason = f"no essential matrix was found for {len(problem)} matches"
        return RelativePose("no_model", reason, inliers, len(problem), warnings=warnings)
    known = uncertainty(found, matches, options)
    evidence = gathered(found, known)
    pose = _judged(found, known, evidence, stated, options)
    inliers[found.problem.index] = pose.inliers
    warnings = tuple(dict.fromkeys((*warnings, *pose.warnings)))
    return replace(pose, inliers=inliers, warnings=warnings)


def gathered(found: Candidates, known: Uncertainty) -> Evidence:
    """The evidence for and against the likeliest candidate."""
    best, *others = found.hypotheses
    evidence = measured(found.problem, best, found.map_problem)
    rotation, still_ratio = evidence.rotation, 0.0
    if found.still is not None:
        still_ratio, R = found.still
        rotation = R if still_ratio > evidence.strict_rotation_share else rotation
    if found.second is not None:
        evidence = replace(
            evidence,
            num_second_inliers=int(found.second.inliers_in_front[~best.inliers].sum()),
            second_rotation_deg=rotation_error_deg(found.second.R, rotation),
        )
    if known.covariance is not None:
        evidence = replace(
            evidence,
            raw_rotation_90_deg=error_radius_deg(known.covariance[:3, :3]),
            raw_translation_90_deg=error_radius_deg(known.covariance[3:, 3:]),
        )
    most_of_others = max((other.num_in_front for other in others), default=0)
    return replace(
        evidence,
        rotation=rotation,
        still_ratio=still_ratio,
        homography_ratio=found.homography_ratio,
        raw_focal_90_percent=known.focal_90_percent,
        focal_check=known.check,
        other_ratio=most_of_others / max(best.num_in_front, 1),
        camera_model=found.model.name,
    )


def _judged(
    found: Candidates,
    known: Uncertainty,
    evidence: Evidence,
    stated: tuple[Camera, Camera],
    options: EstimationOptions,
) -> RelativePose:
    """The likeliest candidate, or why it is no pose. The inliers are over the matches used."""
    best, model = found.hypotheses[0], found.logistic
    probability = None if model is None else model.probability(evidence)
    status, reason, warnings = judge(
        evidence,
        options.min_probability,
        probability,
        () if model is None else model.against(evidence),
        [hypothesis.share for hypothesis in found.hypotheses if hypothesis.likely],
    )
    if status in _OF_CAMERAS:
        warnings += focal_warnings(stated, known.cameras, evidence.focal_check)
        warnings += model_warnings(evidence.camera_model, stated, known.cameras)
    has_t, ambiguous = STATUSES[status].has_t, status == "ambiguous"
    rotation_alone, unusable = status == "rotation_only", status == "panorama"
    poses = [hypothesis for hypothesis in found.hypotheses if hypothesis.likely]
    if second := found.second:  # nothing shows whose motion is the camera's
        poses = [replace(h, share=h.share / 2) for h in poses if not second.is_among([h])]
        poses = sorted([*poses, replace(second, share=0.5)], key=lambda h: -h.share)
    if probability is not None:
        poses = [replace(h, probability=probability * h.share) for h in poses]
    # Of a pose that is not claimed there are no others.
    alternatives = tuple(poses if ambiguous else poses[1:] if has_t else ())
    if alternatives and not ambiguous:
        count = len(alternatives)
        others = "1 other pose explains" if count == 1 else f"{count} other poses explain"
        warnings += (f"{others} the matches about as well: see the alternatives",)
    pose = RelativePose(
        status=status,
        reason=reason,
        inliers=best.inliers,
        num_matches=len(found.problem),
        R=evidence.rotation if rotation_alone else None,
        evidence=evidence,
        probability=0.0 if rotation_alone or ambiguous or unusable else poses[0].probability,
        any_probability=0.0 if unusable else probability,
        alternatives=alternatives,
        hypotheses=() if unusable else tuple(found.hypotheses),
        median_triangulation_angle_deg=evidence.median_triangulation_angle_deg,
        warnings=warnings,
    )
    if not has_t:
        return pose
    covariance = known.covariance
    if covariance is not None and model is not None:
        covariance = model.calibrated(covariance, evidence)
    return replace(
        pose,
        R=best.R,
        t=best.t,
        covariance=covariance,
        camera_covariance=known.camera_covariance,
        camera1=known.cameras[0],
        camera2=known.cameras[1],
    )
