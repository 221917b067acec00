"""From matches and cameras to a relative pose, or to the reason why there is none.

`estimate_pose` has six steps: RANSAC samples hypotheses, the best is refined, others compete with
it, the evidence is measured, the verdict is judged, and the result is put together.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np

from dgc_pose.cameras.camera import Camera
from dgc_pose.estimation.camera_fit import SEARCH_RUNS, JointFit, joint_pose
from dgc_pose.estimation.camera_model import CameraModel, likeliest_model, model_warnings
from dgc_pose.estimation.camera_spread import (
    SIZE,
    CameraSpread,
    deviating_pair,
    deviation_stds,
)
from dgc_pose.estimation.competition import compared, competitors, ranked
from dgc_pose.estimation.covariance import Covariance, pose_covariance
from dgc_pose.estimation.evidence import Evidence, gather
from dgc_pose.estimation.extent import odd_extent
from dgc_pose.estimation.focal_check import check_focals, focal_warnings
from dgc_pose.estimation.hypothesis import Hypothesis
from dgc_pose.estimation.options import EstimationOptions
from dgc_pose.estimation.overlay import are_far, of_the_moving, staying
from dgc_pose.estimation.plane import Plane, best_planar, fit_plane, still_camera
from dgc_pose.estimation.probability import (
    ProbabilityModel,
    calibrated_focal_std,
    shipped_models,
)
from dgc_pose.estimation.problem import TwoViewProblem
from dgc_pose.estimation.result import RelativePose
from dgc_pose.estimation.robust_fit import refine, refit, sample
from dgc_pose.estimation.status import STATUSES
from dgc_pose.estimation.verdict import MIN_MATCHES, Verdict, by_chance, judge
from dgc_pose.matches import Matches
from dgc_pose.system.options import check_type

_DEFAULTS = EstimationOptions()
# Of the inliers, that another motion needs: of a plane's, see docs/experiments.md; and of others',
# where the cameras are fitted.
_MIN_SECOND_SHARE, _MIN_SECOND_SHARE_FITTED = 0.1, 0.3
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
    assessed = assess(problem, matches, stated, options, map_matches, fit_cameras=fit_cameras)
    if assessed is None:
        reason = f"no essential matrix was found for {len(problem)} matches"
        return RelativePose("no_model", reason, inliers, len(problem), warnings=warnings)
    verdict = judge(
        assessed.evidence,
        options.min_probability,
        assessed.probability,
        () if assessed.logistic is None else assessed.logistic.against(assessed.evidence),
        [hypothesis.share for hypothesis in assessed.hypotheses if hypothesis.likely],
    )
    return _result(assessed, verdict, stated, len(matches), warnings)


@dataclass(frozen=True, eq=False)
class Assessment:
    """The poses that explain the matches, and the evidence for and against the likeliest."""

    problem: TwoViewProblem  # normalised by the cameras
    cameras: tuple[Camera, Camera]  # with the focal lengths that the matches determine
    fitted: bool  # whether these were fitted
    hypotheses: Sequence[Hypothesis]  # the likeliest first
    second: Hypothesis | None  # another motion, of the matches that a plane leaves over
    evidence: Evidence
    covariance: Covariance | None
    logistic: ProbabilityModel | None  # None if none is fitted for such matches

    @property
    def probability(self) -> float | None:
        """The probability that R and t of a hypothesis are both within 10 degrees."""
        return None if self.logistic is None else self.logistic.probability(self.evidence)


def assess(
    problem: TwoViewProblem,
    matches: Matches,
    stated: tuple[Camera, Camera],
    options: EstimationOptions,
    map_matches: Matches | None = None,
    *,
    fit_cameras: bool = True,
) -> Assessment | None:
    """The first four steps of `estimate_pose`; None if RANSAC has no essential matrix.

    problem: of the matches, normalised by the stated cameras.
    """
    fitted = fit_cameras and len(CameraSpread.of(*stated)) > 0
    of_stated = problem
    problem, cameras, runs, model = _sample(problem, matches, stated, options, fitted)
    if not runs:
        return None
    first, plane = _refine(problem, runs[0], options)
    map_problem = None
    if map_matches is not None:
        # A threshold in pixels is that of the matches, not of the map.
        map_options = replace(options, threshold_px=None)
        map_problem = TwoViewProblem.of(map_matches, *cameras, map_options)
    of_focal = fitted and any(camera.focal_std for camera in stated)
    logistic = shipped_models().model(
        matches.weights,
        key_points=matches.key_points,
        with_map=bool(map_problem),
        fitted=of_focal,
    )
    others = competitors(problem, first, runs, plane, options)
    hypotheses = compared(problem, first, others, map_problem, options)
    hypotheses = ranked(hypotheses, None if logistic is None else logistic.choice)
    best = hypotheses[0]

    # The spread is what K may be; without it K is to be right.
    spread, check, still, second = CameraSpread.of(*cameras), None, None, None
    if not len(spread):
        check = check_focals(problem, best, matches, cameras, options, is_plane=plane.is_plane)
    if plane.is_plane or fitted:
        least = _MIN_SECOND_SHARE if plane.is_plane else _MIN_SECOND_SHARE_FITTED
        second = _second_motion(problem, best, options, least * best.num_inliers)
    if fitted:
        of_inliers = np.isin(of_stated.index, problem.index[best.inliers])
        still = still_camera(of_stated.subset(of_inliers))
    covariance = pose_covariance(problem, best, spread, fitted=fitted)
    if covariance is not None:
        covariance = replace(covariance, pose=covariance.pose + model.pose_spread)
    evidence = gather(
        problem,
        best,
        plane.share,
        covariance,
        still=still,
        second=second,
        runs=runs,
        others=hypotheses[1:],
        map_problem=map_problem,
        check=check,
        camera_model=model.name,
    )
    if fitted:
        cameras = _fitted(cameras[0], covariance, 0), _fitted(cameras[1], covariance, 1)
    return Assessment(problem, cameras, fitted, hypotheses, second, evidence, covariance, logistic)


def _sample(
    problem: TwoViewProblem,
    matches: Matches,
    stated: tuple[Camera, Camera],
    options: EstimationOptions,
    fitted: bool,
) -> tuple[TwoViewProblem, tuple[Camera, Camera], list[Hypothesis], CameraModel]:
    """RANSAC, if `fitted` with the focal lengths of cameras that are not exact among the unknowns.

    Returns the problem, normalised by the cameras; the cameras; the hypotheses of the runs,
    that with most inliers first, none if there is no essential matrix; and the cameras' model.
    """
    assumed = CameraModel("assumed", stated)
    if not fitted:
        return problem, stated, sample(problem, options), assumed
    joint = JointFit(problem, stated)
    pose = joint_pose(joint, options)
    if pose is None:
        return problem, stated, [], assumed
    model = likeliest_model(problem, matches, stated, pose, options)
    if model.name != "assumed" and model.pose is not None:
        joint = JointFit(TwoViewProblem.of(matches, *model.cameras, options), model.cameras)
        pose = joint.fitted(model.pose)
    cameras = deviating_pair(joint.cameras, joint.deviations(pose))
    problem = TwoViewProblem.of(matches, *cameras, options)
    rest = replace(options, runs=max(1, options.runs - SEARCH_RUNS))
    runs = [Hypothesis.of_pose(problem, pose.R, pose.t), *sample(problem, rest)]
    return problem, cameras, sorted(runs, key=lambda run: -run.num_inliers), model


def _refine(
    problem: TwoViewProblem, first: Hypothesis, options: EstimationOptions
) -> tuple[Hypothesis, Plane]:
    """The refined hypothesis, and the plane that its inliers may lie on."""
    if options.refine:
        first = refine(problem, first)
    plane = fit_plane(problem, first)
    if plane.is_plane and plane.H is not None:
        first = best_planar(problem, first, plane.H, options.refine)
    if options.refine:
        first = refit(problem, first, adapt_scale=True)
    return first, plane


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
    if by_chance(gather(left, second, 0.0)):
        return None
    return Hypothesis.of_pose(problem, second.R, second.t)


def _fitted(camera: Camera, covariance: Covariance | None, number: int) -> Camera:
    """A fitted camera with the standard deviations that are left, calibrated as that of the focal
    length is, and at most those that it had; an exact one as it is."""
    if camera.focal_std:
        camera = replace(camera, focal_source="matches")
    if covariance is None or not any(deviation_stds(camera)):
        return camera
    focal, centre, lens, aspect = _stds(covariance, number)
    factor = calibrated_focal_std(focal) / focal if focal else 1.0
    return replace(
        camera,
        focal_std=min(factor * focal, camera.focal_std),
        centre_std=min(factor * centre * camera.focal, camera.centre_std),
        lens_std=min(factor * lens, camera.lens_std),
        aspect_std=min(factor * aspect, camera.aspect_std),
    )


def _result(
    assessed: Assessment,
    verdict: Verdict,
    stated: tuple[Camera, Camera],
    num_matches: int,
    warnings: tuple[str, ...],
) -> RelativePose:
    """The result of a verdict; num_matches: all, also those that were dropped."""
    problem, evidence, covariance = assessed.problem, assessed.evidence, assessed.covariance
    cameras = assessed.cameras
    best, facts = assessed.hypotheses[0], STATUSES[verdict.status]
    rotation_alone = verdict.status == "rotation_only"
    inliers = np.zeros(num_matches, dtype=bool)
    inliers[problem.index] = best.inliers
    any_right, ambiguous = assessed.probability, verdict.status == "ambiguous"
    unusable = verdict.status == "panorama"
    poses = _explaining(assessed)
    # Of a pose that is not claimed there are no others.
    alternatives = tuple(poses if ambiguous else poses[1:] if facts.has_t else ())
    pose_covariance = camera_covariance = None
    if facts.has_t and covariance is not None:
        pose_covariance = covariance.pose
        if assessed.logistic is not None:
            pose_covariance = assessed.logistic.calibrated(covariance.pose, evidence)
        if assessed.fitted:
            camera_covariance = _camera_covariance(covariance, cameras)
    warnings += verdict.warnings
    if verdict.status in _OF_CAMERAS:
        warnings += focal_warnings(stated, cameras, evidence.focal_check)
        warnings += model_warnings(evidence.camera_model, stated, cameras)
    if alternatives and not ambiguous:
        count = len(alternatives)
        others = "1 other pose explains" if count == 1 else f"{count} other poses explain"
        warnings += (f"{others} the matches about as well: see the alternatives",)
    return RelativePose(
        status=verdict.status,
        reason=verdict.reason,
        inliers=inliers,
        num_matches=len(problem),
        R=best.R if facts.has_t else evidence.rotation if rotation_alone else None,
        t=best.t if facts.has_t else None,
        covariance=pose_covariance,
        camera_covariance=camera_covariance,
        camera1=cameras[0] if facts.has_t else None,
        camera2=cameras[1] if facts.has_t else None,
        evidence=evidence,
        probability=0.0 if rotation_alone or ambiguous or unusable else poses[0].probability,
        any_probability=0.0 if unusable else any_right,
        alternatives=alternatives,
        hypotheses=() if unusable else tuple(assessed.hypotheses),
        median_triangulation_angle_deg=evidence.median_triangulation_angle_deg,
        warnings=tuple(dict.fromkeys(warnings)),
    )


def _explaining(assessed: Assessment) -> list[Hypothesis]:
    """The poses that explain the matches about as well, with their probabilities, the likeliest
    first."""
    explaining = [hypothesis for hypothesis in assessed.hypotheses if hypothesis.likely]
    if second := assessed.second:  # nothing shows whose motion is the camera's
        explaining = [replace(h, share=h.share / 2) for h in explaining if not second.is_among([h])]
        explaining.append(replace(second, share=0.5))
        explaining.sort(key=lambda h: -h.share)
    any_right = assessed.probability
    if any_right is None:
        return explaining
    return [replace(h, probability=any_right * h.share) for h in explaining]


def _camera_covariance(covariance: Covariance, cameras: tuple[Camera, Camera]) -> np.ndarray:
    """The covariance (12, 12) of fitted cameras, with their deviations, see `RelativePose`."""
    unit = []
    for number, camera in enumerate(cameras):
        of_camera = camera.focal_std, camera.centre_std, camera.lens_std, camera.aspect_std
        ratios = zip(of_camera, _stds(covariance, number), strict=True)
        focal, centre, lens, aspect = (std / raw if raw else 0.0 for std, raw in ratios)
        unit += [focal, centre, centre, lens, lens, aspect]
    return covariance.cameras * np.outer(unit, unit)


def _stds(covariance: Covariance, number: int) -> tuple[float, float, float, float]:
    """The standard deviations of camera 0's or 1's ln f, principal point over f, lens, and ln fy /
    fx."""
    variances = covariance.cameras.diagonal()[SIZE * number :][:SIZE].tolist()
    focal, x, y, lens, _, aspect = variances
    return focal**0.5, ((x + y) / 2) ** 0.5, lens**0.5, aspect**0.5
