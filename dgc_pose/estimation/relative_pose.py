"""From matches and cameras to a relative pose, or to the reason why there is none."""

from __future__ import annotations

from dataclasses import dataclass, replace
from functools import partial

import numpy as np

from dgc_pose.cameras.camera import Camera
from dgc_pose.estimation.camera_check import check_focals, focal_warnings
from dgc_pose.estimation.camera_fit import SEARCH_RUNS, fit_cameras
from dgc_pose.estimation.camera_spread import CameraSpread
from dgc_pose.estimation.choice import hypotheses, ranked
from dgc_pose.estimation.covariance import Covariance, pose_covariance
from dgc_pose.estimation.evidence import Evidence, gather
from dgc_pose.estimation.model import Model
from dgc_pose.estimation.options import EstimationOptions
from dgc_pose.estimation.poselib_calls import sampled_models
from dgc_pose.estimation.probability import (
    ProbabilityModel,
    calibrated_focal_std,
    match_kind,
    shipped_models,
)
from dgc_pose.estimation.problem import TwoViewProblem
from dgc_pose.estimation.refine import best_planar_model, planar_share, refine, refit
from dgc_pose.estimation.result import Alternative, RelativePose
from dgc_pose.estimation.rivals import known, rivals
from dgc_pose.estimation.status import STATUSES
from dgc_pose.estimation.still_camera import still_camera
from dgc_pose.estimation.verdict import by_chance, judge
from dgc_pose.matches import Matches
from dgc_pose.system.options import check_type

_DEFAULTS = EstimationOptions()
_SECOND = 0.1  # of a plane's inliers, that another motion needs; see docs/experiments.md
_OF_CAMERAS = ("ok", "planar", "improbable")  # statuses of models that say something of K


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
    fitted; without, their deviations only widen the errors. The same seed gives the same answer to
    the bit. Raises InputError if `matches` is not Matches.
    """
    check_type(options, EstimationOptions, "options")
    check_type(camera1, Camera, "camera1")
    check_type(camera2, Camera, "camera2")
    problem = TwoViewProblem.of(matches, camera1, camera2, options)
    inliers = np.zeros(len(matches), dtype=bool)
    failure = partial(
        RelativePose, inliers=inliers, num_matches=len(problem), warnings=problem.warnings
    )
    if len(problem) < options.verdict.min_matches:
        reason = f"only {len(problem)} matches; a verdict needs {options.verdict.min_matches}"
        return failure("too_few_matches", reason)
    stated, of_stated = (camera1, camera2), problem
    fits = fit_cameras and len(CameraSpread.of(camera1, camera2)) > 0
    sampled = _sampled(problem, matches, camera1, camera2, options, fits)
    problem, camera1, camera2 = sampled.problem, sampled.camera1, sampled.camera2
    spread, runs = CameraSpread.of(camera1, camera2), sampled.runs
    if not runs:
        return failure("no_model", f"no essential matrix was found for {len(problem)} matches")
    map_problem = None
    if map_matches is not None:
        # A threshold in pixels is that of the matches, not of the map.
        map_options = replace(options, threshold_px=None)
        map_problem = TwoViewProblem.of(map_matches, camera1, camera2, map_options)
    kind = match_kind(key_points=problem.key_points, with_map=bool(map_problem), fitted=fits)
    logistic = shipped_models().by_kind.get(kind)

    first, homography = _refined(problem, runs[0], options)
    others = rivals(problem, first, runs, homography, options)
    choices = ranked(
        hypotheses(problem, first, others, map_problem, options),
        None if logistic is None else logistic.choice,
    )
    model = choices[0].model
    others = [choice.model for choice in choices[1:]]

    # A spread says what K may be; without it K is to be right. A plane's homography fits poses of
    # any focal length, so a plane does not tell it.
    check = None
    if not len(spread) and homography[0] < options.verdict.planar_share:
        check = check_focals(problem, model, matches, camera1, camera2, options)
    still, second = None, None
    if homography[0] >= options.verdict.planar_share:
        second = _second_motion(problem, model, options)
        if fits:
            of_inliers = np.isin(of_stated.index, problem.index[model.inliers])
            still = still_camera(of_stated.subset(of_inliers))
    covariance = pose_covariance(problem, model, spread, fitted=fits)
    evidence = gather(
        problem,
        model,
        homography[0],
        covariance,
        still=still,
        second=second,
        runs=runs,
        rivals=others,
        map_problem=map_problem,
        check=check,
    )
    best = _Assessed(evidence, covariance, logistic)
    likely = [choice for choice in choices if choice.likely]
    any_right = best.probability
    verdict = judge(
        evidence,
        options.verdict,
        any_right,
        () if logistic is None else logistic.against(evidence),
        [choice.share for choice in likely],
    )

    inliers[problem.index] = model.inliers
    facts = STATUSES[verdict.status]
    explained = [(choice.model, choice.share) for choice in likely]
    if second is not None:  # nothing tells whose motion is the camera's
        explained = [(m, share / 2) for m, share in explained if not known(second, [m])]
        explained.append((second, 0.5))
    poses = [
        Alternative(m.R, m.t, m.count, None if any_right is None else any_right * share)
        for m, share in explained
    ]
    ambiguous = verdict.status == "ambiguous"
    # Of a pose that is not claimed there are no others.
    alternatives = tuple(poses if ambiguous else poses[1:] if facts.has_t else ())
    cameras = (best.camera(camera1, 0), best.camera(camera2, 1)) if fits else (camera1, camera2)
    return RelativePose(
        status=verdict.status,
        reason=verdict.reason,
        inliers=inliers,
        num_matches=len(problem),
        R=model.R if facts.has_t else evidence.rotation if facts.rotation_alone else None,
        t=model.t if facts.has_t else None,
        covariance=best.calibrated_covariance if facts.has_t else None,
        camera_covariance=best.camera_covariance(*cameras) if facts.has_t and fits else None,
        camera1=cameras[0] if facts.has_t else None,
        camera2=cameras[1] if facts.has_t else None,
        evidence=evidence,
        probability=0.0 if facts.rotation_alone or ambiguous else poses[0].probability,
        any_probability=any_right,
        alternatives=alternatives,
        hypotheses=tuple(choices),
        warnings=(
            *problem.warnings,
            *verdict.warnings,
            *(focal_warnings(stated, cameras, check) if verdict.status in _OF_CAMERAS else ()),
            *(() if ambiguous else _warnings(len(alternatives))),
        ),
    )


@dataclass(frozen=True, eq=False)
class _Sampled:
    """The results of RANSAC."""

    problem: TwoViewProblem  # normalised by the cameras
    camera1: Camera  # as the matches tell, if they are not exact
    camera2: Camera
    runs: list[Model]  # that with most inliers first; none if there is no essential matrix


def _sampled(
    problem: TwoViewProblem,
    matches: Matches,
    camera1: Camera,
    camera2: Camera,
    options: EstimationOptions,
    fits: bool,
) -> _Sampled:
    """RANSAC, if `fits` with the focal lengths of cameras that are not exact among the unknowns.

    problem: of the matches, normalised by the two cameras.
    """
    if not fits:
        return _Sampled(problem, camera1, camera2, sampled_models(problem, options))
    fit = fit_cameras(problem, camera1, camera2, options)
    if fit is None:
        return _Sampled(problem, camera1, camera2, [])
    problem = TwoViewProblem.of(matches, fit.camera1, fit.camera2, options)
    rest = replace(options, runs=max(1, options.runs - SEARCH_RUNS))
    runs = [Model.of_pose(problem, fit.R, fit.t), *sampled_models(problem, rest)]
    runs.sort(key=lambda model: -model.count)
    return _Sampled(problem, fit.camera1, fit.camera2, runs)


@dataclass(frozen=True, eq=False)
class _Assessed:
    """The evidence of a model, and the logistic model of its probability if there is one."""

    evidence: Evidence
    covariance: Covariance | None
    logistic: ProbabilityModel | None

    @property
    def probability(self) -> float | None:
        return None if self.logistic is None else self.logistic.probability(self.evidence)

    @property
    def calibrated_covariance(self) -> np.ndarray | None:
        if self.covariance is None:
            return None
        if self.logistic is None:
            return self.covariance.pose
        return self.logistic.calibrated(self.covariance.pose, self.evidence)

    def camera(self, camera: Camera, number: int) -> Camera:
        """A fitted camera with the standard deviation that is left; an exact one as it is."""
        if not camera.focal_std:
            return camera
        std = camera.focal_std
        if self.covariance is not None:
            std = calibrated_focal_std(self.covariance.focal_stds[number])
        return replace(camera, focal_std=std, focal_source="matches")

    def camera_covariance(self, camera1: Camera, camera2: Camera) -> np.ndarray | None:
        """That of fitted cameras, see `RelativePose`."""
        if self.covariance is None:
            return None
        unit = []
        for camera, std in zip((camera1, camera2), self.covariance.focal_stds, strict=True):
            factor = calibrated_focal_std(std) / std if std else 1.0
            unit += [factor, factor * camera.focal, factor * camera.focal]
        return self.covariance.cameras * np.outer(unit, unit)


def _second_motion(
    problem: TwoViewProblem, model: Model, options: EstimationOptions
) -> Model | None:
    """Another motion, of the matches that a model leaves over alone; None if it has few inliers, or
    if unrelated images could have as many."""
    left = problem.subset(~model.inliers)
    if len(left) < options.verdict.min_matches:
        return None
    runs = sampled_models(left, replace(options, runs=1))
    if not runs:
        return None
    second = refine(left, runs[0]) if options.refine else runs[0]
    if known(second, [model]) or second.count_in_front < _SECOND * model.count_in_front:
        return None
    return None if by_chance(gather(left, second, 0.0), options.verdict) else second


def _warnings(alternatives: int) -> tuple[str, ...]:
    if not alternatives:
        return ()
    others = "1 other pose explains" if alternatives == 1 else f"{alternatives} other poses explain"
    return (f"{others} the matches about as well: see the alternatives",)


def _refined(
    problem: TwoViewProblem, model: Model, options: EstimationOptions
) -> tuple[Model, tuple[float, np.ndarray | None]]:
    """The refined model; the share of inliers that one homography explains, and the homography."""
    if options.refine:
        model = refine(problem, model)
    share, H = planar_share(problem, model)
    if H is not None and share >= options.verdict.planar_share:
        model = best_planar_model(problem, model, H, options.refine)
    if options.refine:
        model = refit(problem, model, adapt_scale=True)
    return model, (share, H)
