"""From matches and cameras to a relative pose, or to the reason why there is none.

`estimate_pose` finds the candidates, computes the uncertainty of the likeliest, and judges it by
the evidence.

Some matches may stay at the same pixels while others move: on an overlay (a watermark, a hood), or
on the background behind an object that turned. They fit a camera that stood still and contain
nothing about the motion of the others, so the estimation drops them.
"""

from __future__ import annotations

import math
from dataclasses import dataclass, replace

import numpy as np

from dgc_pose.cameras.camera import Camera
from dgc_pose.estimation.camera_model import camera_warnings, unusual_cameras
from dgc_pose.estimation.candidates import Candidates, candidates
from dgc_pose.estimation.covariance import NORMAL_90, error_radius_deg, pose_covariance
from dgc_pose.estimation.evidence import Evidence, measured
from dgc_pose.estimation.intrinsics_prior import FOCALS, SIZE, IntrinsicsPrior, parameter_stds
from dgc_pose.estimation.options import EstimationOptions
from dgc_pose.estimation.probability import DOUBTFUL, ProbabilityModel, calibrated_focal_std
from dgc_pose.estimation.problem import MIN_MATCHES, Hypothesis, TwoViewProblem, odd_extent
from dgc_pose.estimation.result import RelativePose
from dgc_pose.estimation.status import STATUSES, Status
from dgc_pose.estimation.still_camera import StillCamera
from dgc_pose.estimation.verdict import by_chance, is_amid_others, judge
from dgc_pose.geometry.pixels import rescale
from dgc_pose.geometry.rotation import rotation_angle_deg
from dgc_pose.matches import Matches
from dgc_pose.metrics import rotation_error_deg
from dgc_pose.system.options import check_type
from dgc_pose.system.parallel import one_blas_thread

_DEFAULTS = EstimationOptions()
# Matches that stay at the same pixels:
_STAY_PX = 1.0  # their largest motion; or the expected error of the matches, if this is larger
_NEAR = 3.0  # times this: limit of a small motion. A moving camera has as many small motions.
_MIN_COUNT = 20  # their least number
_MIN_SHARE = 0.04  # their least share of the matches
_MOST_ERROR_DEG = 2.0  # largest error of R that allows them to be points far away
_MOST = 0.6  # their share of the matches up to which the others decide


@one_blas_thread()
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
    the probability. fit_cameras: whether to fit the focal lengths of cameras that are not exact; if
    False, their deviations only widen the errors. The pose includes the warnings of the cameras.
    The same seed gives the same answer to the bit. Raises InputError, naming the argument, for an
    argument of the wrong type, and for points outside their camera's size.
    """
    check_type(matches, Matches, "matches")
    check_type(options, EstimationOptions, "options")
    check_type(camera1, Camera, "camera1")
    check_type(camera2, Camera, "camera2")
    odd = odd_extent(matches.points1, camera1, 1) + odd_extent(matches.points2, camera2, 2)
    cameras = (camera1, camera2)
    stay = staying(matches, camera1, camera2)
    pose = None
    if stay.any():
        map_left = map_matches and map_matches.subset(~staying(map_matches, *cameras))
        moving = replace(matches.subset(~stay), context_ratio=None)  # measured with the others
        problem = TwoViewProblem.of(moving, *cameras, options)
        pose = _estimated(problem, map_left, fit_cameras)
        pose = None if _are_far(pose, camera1) else _with_static_matches(pose, stay)
    if pose is None:
        problem = TwoViewProblem.of(matches, *cameras, options)
        pose = _estimated(problem, map_matches, fit_cameras)
    return replace(pose, warnings=tuple(dict.fromkeys((*pose.warnings, *odd))))


def reject_contradicted_K(pose: RelativePose, stated: tuple[Camera, Camera]) -> RelativePose:
    """The pose, rejected if the matches agree with other cameras than K states: further pairs would
    not use these cameras. stated: the cameras before the estimation."""
    evidence = pose.evidence
    cameras = pose.cameras
    if evidence is None or cameras is None or not pose.contradicts_K:
        return pose
    lines = unusual_cameras(evidence.camera_model, stated, cameras)
    reason = lines[0] if lines else "the matches contradict K"
    none = np.zeros_like(pose.inliers)
    return RelativePose("improbable", reason, none, pose.num_matches, evidence=evidence)


def staying(matches: Matches, camera1: Camera, camera2: Camera) -> np.ndarray:
    """Which matches stay at the same pixels, (N,) bool; none if these are few, or no more than the
    matches that move a little: a camera that moves may also leave a part of the image in place."""
    points2 = matches.points2
    if camera1.size is not None and camera2.size is not None:
        points2 = rescale(points2, camera2.size, camera1.size)
    with np.errstate(invalid="ignore"):  # points that are not finite
        moved = np.hypot(*(points2 - matches.points1).T) / max(_STAY_PX, matches.error_px)
    stay = moved < 1
    little = (moved >= 1) & (moved < _NEAR)
    least = max(_MIN_COUNT, _MIN_SHARE * np.isfinite(moved).sum())
    if stay.sum() < least or stay.sum() <= little.sum():
        return np.zeros(len(stay), dtype=bool)
    return stay


def _are_far(pose: RelativePose, camera: Camera) -> bool:
    """Whether points that stay at the same pixels may be far away: the rotation of the pose of the
    others is at most one pixel plus its error. camera: of image 1."""
    if pose.evidence is None or not pose.hypotheses:
        return False
    allowed = math.degrees(_STAY_PX / camera.focal)
    error = pose.evidence.raw_rotation_90_deg or 0.0
    return rotation_angle_deg(pose.hypotheses[0].R) < allowed + min(error, _MOST_ERROR_DEG)


def _with_static_matches(pose: RelativePose, stay: np.ndarray) -> RelativePose:
    """The pose of the matches that move, as a pose of all matches. stay: (N,) bool, the others. If
    most matches stay, the camera may have stood still instead."""
    count = int(stay.sum()) + pose.num_matches  # without those that are not finite
    part = stay.sum() / count
    share = f"{stay.sum()} of {count} matches ({100 * part:.0f} %)"
    inliers = np.zeros(len(stay), dtype=bool)
    inliers[~stay] = pose.inliers
    if part <= _MOST:
        warning = (
            f"{share} stay at the same pixels and are dropped: an overlay or still background; "
            "exclude it by mask1 and mask2"
        )
        return replace(pose, inliers=inliers, warnings=(*pose.warnings, warning))
    reason = f"{share} stay at the same pixels"
    if not pose.success:
        reason += "" if part == 1 else ", and the others determine no pose"
        return RelativePose("same_picture", reason, inliers, count, warnings=pose.warnings)
    reason += f", and {pose.num_inliers} fit a motion: either may be the camera's"
    # The camera moved, or stood still.
    moving = (pose.hypotheses[0], *pose.alternatives)
    both = tuple(
        h if h.probability is None else replace(h, probability=h.probability / 2) for h in moving
    )
    return RelativePose(
        "ambiguous",
        reason,
        inliers,
        pose.num_matches,
        probability=0.0,
        any_probability=pose.any_probability,
        same_place_probability=pose.same_place_probability,
        tested_matchers=pose.tested_matchers,
        alternatives=both,
        hypotheses=pose.hypotheses,
        warnings=pose.warnings,
    )


def _estimated(
    problem: TwoViewProblem, map_matches: Matches | None, fit_cameras: bool
) -> RelativePose:
    """`estimate_pose` for matches of one motion, normalised by the stated cameras."""
    lines = (*(line for camera in problem.cameras for line in camera.warnings), *problem.warnings)
    warnings = tuple(dict.fromkeys(lines))
    inliers = np.zeros(len(problem.matches), dtype=bool)

    def failure(status: Status, reason: str) -> RelativePose:
        return RelativePose(status, reason, inliers, len(problem), warnings=warnings)

    for number, camera in enumerate(problem.cameras, start=1):
        if camera.projection:
            reason = f"image {number} is {camera.projection}, as its XMP data state"
            return failure("panorama", reason)
    if len(problem) < MIN_MATCHES:
        reason = f"only {len(problem)} matches; a verdict needs {MIN_MATCHES}"
        return failure("too_few_matches", reason)
    found = candidates(problem, map_matches, fit_cameras=fit_cameras)
    if found is None:
        return failure("no_model", f"no essential matrix was found for {len(problem)} matches")
    known = uncertainty(found)
    pose = _judged(found, known, gathered(found, known), problem.cameras)
    inliers[found.problem.index] = pose.inliers
    warnings = tuple(dict.fromkeys((*warnings, *pose.warnings)))
    return replace(pose, inliers=inliers, warnings=warnings)


@dataclass(frozen=True, eq=False)
class Uncertainty:
    """The uncertainty of the likeliest pose."""

    cameras: tuple[Camera, Camera]  # with the remaining standard deviations, calibrated
    # (6, 6), see `pose_covariance`, not calibrated; None if the inliers do not determine it.
    covariance: np.ndarray | None = None
    camera_covariance: np.ndarray | None = None  # (12, 12), see `RelativePose`
    # Bound of the error of ln f in nine cases of ten, of the less certain camera, per cent, not
    # calibrated; None if both focal lengths are exact.
    focal_90_percent: float | None = None


def uncertainty(found: Candidates) -> Uncertainty:
    """The uncertainty of the likeliest candidate and of its cameras."""
    problem = found.problem
    best = found.hypotheses[0]
    cameras = found.model.cameras
    prior = IntrinsicsPrior.of(*cameras)
    covariances = pose_covariance(problem, best, prior, fitted=found.fitted)
    if found.fitted:
        first, second = (
            replace(c, focal_source="matches", focal_prior=None) if c.focal_std else c
            for c in cameras
        )
        cameras = first, second
    if covariances is None:
        return Uncertainty(cameras)
    by_pose, by_cameras = covariances
    covariance = by_pose + found.model.pose_covariance
    focal_std = float(np.sqrt(by_cameras.diagonal()[FOCALS].max()))
    camera_covariance = None
    if found.fitted:
        first, unit1 = _calibrated(cameras[0], by_cameras[:SIZE, :SIZE])
        second, unit2 = _calibrated(cameras[1], by_cameras[SIZE:, SIZE:])
        cameras = first, second
        units = np.concatenate([unit1, unit2])
        camera_covariance = by_cameras * np.outer(units, units)
    focal_90_percent = 100 * NORMAL_90 * focal_std or None
    return Uncertainty(cameras, covariance, camera_covariance, focal_90_percent)


def _calibrated(camera: Camera, covariance: np.ndarray) -> tuple[Camera, np.ndarray]:
    """A fitted camera with standard deviations from a covariance (6, 6), with the calibration of
    the focal length and not above the camera's own; and the ratios (6,) of these, with the
    principal point in pixels, to the raw deviations of its parameters, 0 for exact ones."""
    if camera.exact:
        return camera, np.zeros(SIZE)
    raw = camera.with_deviations(covariance.diagonal())
    factor = calibrated_focal_std(raw.focal_std) / raw.focal_std if raw.focal_std else 1.0
    calibrated = replace(
        camera,
        focal_std=min(factor * raw.focal_std, camera.focal_std),
        centre_std=min(factor * raw.centre_std, camera.centre_std),
        lens_std=min(factor * raw.lens_std, camera.lens_std),
        aspect_std=min(factor * raw.aspect_std, camera.aspect_std),
    )
    before = np.array(parameter_stds(raw))
    ratios = np.divide(parameter_stds(calibrated), before, out=np.zeros(SIZE), where=before > 0)
    return calibrated, ratios * (1, camera.focal, camera.focal, 1, 1, 1)


def gathered(found: Candidates, known: Uncertainty) -> Evidence:
    """The evidence for and against the likeliest candidate."""
    best, *others = found.hypotheses
    evidence = measured(found.problem, best, found.map_problem)
    rotation = evidence.rotation
    second = found.second
    covariance = known.covariance
    still_ratio = min(found.still.count / max(best.num_inliers, 1), 1.0)
    if still_ratio >= evidence.strict_rotation_share:
        rotation = found.still.R
    if second is not None:
        left = found.problem.subset(~best.inliers)
        second_left = Hypothesis.of_pose(left, second.R, second.t)
        if not by_chance(measured(left, second_left)):
            evidence = replace(
                evidence,
                num_second_inliers=second_left.num_in_front,
                second_rotation_deg=rotation_error_deg(second.R, rotation),
            )
    errors: tuple[float | None, float | None] = (None, None)
    if covariance is not None:
        errors = error_radius_deg(covariance[:3, :3]), error_radius_deg(covariance[3:, 3:])
    most_of_others = max((other.num_in_front for other in others), default=0)
    return replace(
        evidence,
        rotation=rotation,
        still_ratio=still_ratio,
        homography_ratio=found.homography_ratio,
        around_plane=found.around_plane,
        raw_rotation_90_deg=errors[0],
        raw_translation_90_deg=errors[1],
        raw_focal_90_percent=known.focal_90_percent,
        other_ratio=most_of_others / max(best.num_in_front, 1),
        camera_model=found.model.model.name,
        camera_agreement=found.model.agreement,
        camera_doubt=found.model.doubt,
    )


def _rotation_covariance(still: StillCamera, model: ProbabilityModel | None) -> np.ndarray | None:
    """The covariance (6, 6) of a rotation without a translation, calibrated as that of a pose."""
    if still.covariance is None:
        return None
    factor = 1.0
    if model is not None:
        factor = model.rotation_error.factor(error_radius_deg(still.covariance))
    covariance = np.zeros((6, 6))
    covariance[:3, :3] = factor**2 * still.covariance
    return covariance


def _judged(
    found: Candidates, known: Uncertainty, evidence: Evidence, stated: tuple[Camera, Camera]
) -> RelativePose:
    """The likeliest candidate, or why it is no pose. The inliers are over the matches used."""
    best = found.hypotheses[0]
    model = found.logistic
    probability = None if model is None else model.probability(evidence)
    same_place = 1.0 if model is None else model.same_place.probability(evidence)
    status, reason, warnings = judge(
        evidence,
        found.problem.options.min_probability,
        probability,
        () if model is None else model.against(evidence),
        [hypothesis.share for hypothesis in found.hypotheses if hypothesis.likely],
        same_place,
    )
    if STATUSES[status].shows_cameras:
        warnings += camera_warnings(evidence.camera_model, stated, known.cameras)
    has_t = STATUSES[status].has_t
    ambiguous = status == "ambiguous"
    rotation_alone = status == "rotation_only"
    unusable = status == "panorama"
    has_pose = status not in ("rotation_only", "ambiguous", "panorama", "chance_inliers")
    poses = [hypothesis for hypothesis in found.hypotheses if hypothesis.likely]
    # The matches do not show which motion is the camera's.
    if ambiguous and evidence.num_second_inliers and (second := found.second):
        own = [h for h in poses if not second.is_among([h])]
        total = sum(h.share for h in own)
        poses = [replace(h, share=0.5 * h.share / total) for h in own]
        poses = sorted([*poses, replace(second, share=0.5)], key=lambda h: -h.share)
    if ambiguous and probability is not None and is_amid_others(evidence):
        probability /= 2  # the plane may have moved as well as not
    if probability is not None:
        poses = [replace(h, probability=same_place * probability * h.share) for h in poses]
    # Without a claimed pose there are no alternatives.
    alternatives = tuple(poses if ambiguous else poses[1:] if has_t else ())
    if has_t and same_place < DOUBTFUL:
        warnings += ("the surroundings of the matches differ between the images",)
    if alternatives and not ambiguous:
        count = len(alternatives)
        others = "1 other pose explains" if count == 1 else f"{count} other poses explain"
        warnings += (f"{others} the matches about as well: see the alternatives",)
    covariance = known.covariance if has_t else None
    if covariance is not None and model is not None:
        covariance = model.calibrated(covariance, evidence)
    if rotation_alone and evidence.rotation is found.still.R:
        covariance = _rotation_covariance(found.still, model)
    camera1, camera2 = known.cameras if has_t else (None, None)
    return RelativePose(
        status=status,
        reason=reason,
        inliers=best.inliers,
        num_matches=len(found.problem),
        R=best.R if has_t else evidence.rotation if rotation_alone else None,
        t=best.t if has_t else None,
        covariance=covariance,
        camera1=camera1,
        camera2=camera2,
        camera_covariance=known.camera_covariance if has_t else None,
        evidence=evidence,
        probability=poses[0].probability if has_pose else 0.0,
        any_probability=0.0 if unusable else probability,
        same_place_probability=same_place,
        tested_matchers=() if model is None else model.tested,
        alternatives=alternatives,
        hypotheses=() if unusable else tuple(found.hypotheses),
        cameras=known.cameras,
        median_triangulation_angle_deg=evidence.median_triangulation_angle_deg,
        warnings=warnings,
    )
