"""From matches and cameras to a relative pose, or to the reason why there is none.

`estimate_pose` has six steps: RANSAC samples models, the best is refined, others compete with it,
the evidence is measured, the verdict is judged, and the result is put together.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np

from dgc_pose.cameras.camera import Camera
from dgc_pose.estimation.camera_check import check_focals, focal_warnings
from dgc_pose.estimation.camera_fit import SEARCH_RUNS, fit_cameras
from dgc_pose.estimation.camera_spread import CameraSpread
from dgc_pose.estimation.choice import Hypothesis, hypotheses, ranked
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
from dgc_pose.estimation.refine import (
    PLANAR_SHARE,
    best_planar_model,
    planar_share,
    refine,
    refit,
)
from dgc_pose.estimation.result import RelativePose
from dgc_pose.estimation.rivals import known, rivals
from dgc_pose.estimation.status import STATUSES
from dgc_pose.estimation.still_camera import still_camera
from dgc_pose.estimation.verdict import MIN_MATCHES, Verdict, by_chance, judge
from dgc_pose.matches import Matches
from dgc_pose.system.options import check_type

_DEFAULTS = EstimationOptions()
_SECOND_SHARE = 0.1  # of a plane's inliers, that another motion needs; see docs/experiments.md
_OF_CAMERAS = ("ok", "planar", "improbable")  # statuses of models that are evidence of K


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
    those of the pose. The same seed gives the same answer to the bit. Raises InputError if
    `matches` is not Matches.
    """
    check_type(options, EstimationOptions, "options")
    check_type(camera1, Camera, "camera1")
    check_type(camera2, Camera, "camera2")
    problem = TwoViewProblem.of(matches, camera1, camera2, options)
    warnings = tuple(dict.fromkeys((*camera1.warnings, *camera2.warnings, *problem.warnings)))
    inliers = np.zeros(len(matches), dtype=bool)
    if len(problem) < MIN_MATCHES:
        reason = f"only {len(problem)} matches; a verdict needs {MIN_MATCHES}"
        return RelativePose("too_few_matches", reason, inliers, len(problem), warnings=warnings)
    stated = camera1, camera2
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
    second: Model | None  # another motion, of the matches that a plane leaves over
    evidence: Evidence
    covariance: Covariance | None
    logistic: ProbabilityModel | None  # None if none is fitted for such matches

    @property
    def probability(self) -> float | None:
        """That R and t of one of the hypotheses are both within 10 degrees."""
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
    problem, cameras, runs = _sample(problem, matches, stated, options, fitted)
    if not runs:
        return None
    best, homography = _refine(problem, runs[0], options)
    map_problem = None
    if map_matches is not None:
        # A threshold in pixels is that of the matches, not of the map.
        map_options = replace(options, threshold_px=None)
        map_problem = TwoViewProblem.of(map_matches, *cameras, map_options)
    kind = match_kind(key_points=problem.key_points, with_map=bool(map_problem), fitted=fitted)
    logistic = shipped_models().by_kind.get(kind)
    competing = _compete(problem, best, runs, homography, map_problem, logistic, options)
    model, is_plane = competing[0].model, homography[0] >= PLANAR_SHARE

    # The spread is what K may be; without it K is to be right. A plane's homography fits poses of
    # any focal length, so a plane does not determine it.
    spread, check, still, second = CameraSpread.of(*cameras), None, None, None
    if not len(spread) and not is_plane:
        check = check_focals(problem, model, matches, *cameras, options)
    if is_plane:
        second = _second_motion(problem, model, options)
    if is_plane and fitted:
        of_inliers = np.isin(of_stated.index, problem.index[model.inliers])
        still = still_camera(of_stated.subset(of_inliers))
    covariance = pose_covariance(problem, model, spread, fitted=fitted)
    evidence = gather(
        problem,
        model,
        homography[0],
        covariance,
        still=still,
        second=second,
        runs=runs,
        rivals=[hypothesis.model for hypothesis in competing[1:]],
        map_problem=map_problem,
        check=check,
    )
    return Assessment(problem, cameras, fitted, competing, second, evidence, covariance, logistic)


def _sample(
    problem: TwoViewProblem,
    matches: Matches,
    stated: tuple[Camera, Camera],
    options: EstimationOptions,
    fitted: bool,
) -> tuple[TwoViewProblem, tuple[Camera, Camera], list[Model]]:
    """RANSAC, if `fitted` with the focal lengths of cameras that are not exact among the unknowns.

    Returns the problem, normalised by the cameras; the cameras; and the models of the runs, that
    with most inliers first, none if there is no essential matrix.
    """
    if not fitted:
        return problem, stated, sampled_models(problem, options)
    fit = fit_cameras(problem, *stated, options)
    if fit is None:
        return problem, stated, []
    problem = TwoViewProblem.of(matches, fit.camera1, fit.camera2, options)
    rest = replace(options, runs=max(1, options.runs - SEARCH_RUNS))
    runs = [Model.of_pose(problem, fit.R, fit.t), *sampled_models(problem, rest)]
    return problem, (fit.camera1, fit.camera2), sorted(runs, key=lambda model: -model.count)


def _refine(
    problem: TwoViewProblem, model: Model, options: EstimationOptions
) -> tuple[Model, tuple[float, np.ndarray | None]]:
    """The refined model; the share of inliers that one homography explains, and the homography."""
    if options.refine:
        model = refine(problem, model)
    share, H = planar_share(problem, model)
    if H is not None and share >= PLANAR_SHARE:
        model = best_planar_model(problem, model, H, options.refine)
    if options.refine:
        model = refit(problem, model, adapt_scale=True)
    return model, (share, H)


def _compete(
    problem: TwoViewProblem,
    best: Model,
    runs: Sequence[Model],
    homography: tuple[float, np.ndarray | None],
    map_problem: TwoViewProblem | None,
    logistic: ProbabilityModel | None,
    options: EstimationOptions,
) -> list[Hypothesis]:
    """The refined model and the others that explain matches, the likeliest first."""
    others = rivals(problem, best, runs, homography, options)
    among = hypotheses(problem, best, others, map_problem, options)
    return ranked(among, None if logistic is None else logistic.choice)


def _second_motion(
    problem: TwoViewProblem, model: Model, options: EstimationOptions
) -> Model | None:
    """Another motion, of the matches that a model leaves over alone; None if it has few inliers, or
    if unrelated images could have as many."""
    left = problem.subset(~model.inliers)
    if len(left) < MIN_MATCHES:
        return None
    runs = sampled_models(left, replace(options, runs=1))
    if not runs:
        return None
    second = refine(left, runs[0]) if options.refine else runs[0]
    if known(second, [model]) or second.count_in_front < _SECOND_SHARE * model.count_in_front:
        return None
    return None if by_chance(gather(left, second, 0.0)) else second


def _result(
    assessed: Assessment,
    verdict: Verdict,
    stated: tuple[Camera, Camera],
    num_matches: int,
    warnings: tuple[str, ...],
) -> RelativePose:
    """The result of a verdict; num_matches: all, also those that were dropped."""
    problem, evidence, covariance = assessed.problem, assessed.evidence, assessed.covariance
    model, facts = assessed.hypotheses[0].model, STATUSES[verdict.status]
    inliers = np.zeros(num_matches, dtype=bool)
    inliers[problem.index] = model.inliers
    any_right, ambiguous = assessed.probability, verdict.status == "ambiguous"
    poses = _explaining(assessed)
    # Of a pose that is not claimed there are no others.
    alternatives = tuple(poses if ambiguous else poses[1:] if facts.has_t else ())
    cameras = fitted_cameras(assessed) if assessed.fitted else assessed.cameras
    pose_covariance = camera_covariance = None
    if facts.has_t and covariance is not None:
        pose_covariance = covariance.pose
        if assessed.logistic is not None:
            pose_covariance = assessed.logistic.calibrated(covariance.pose, evidence)
        if assessed.fitted:
            camera_covariance = _camera_covariance(covariance, cameras)
    if verdict.status in _OF_CAMERAS:
        of_focals = focal_warnings(stated, cameras, evidence.focal_check)
    else:
        of_focals = ()
    of_others = () if ambiguous else _warnings_of(len(alternatives))
    return RelativePose(
        status=verdict.status,
        reason=verdict.reason,
        inliers=inliers,
        num_matches=len(problem),
        R=model.R if facts.has_t else evidence.rotation if facts.rotation_alone else None,
        t=model.t if facts.has_t else None,
        covariance=pose_covariance,
        camera_covariance=camera_covariance,
        camera1=cameras[0] if facts.has_t else None,
        camera2=cameras[1] if facts.has_t else None,
        evidence=evidence,
        probability=0.0 if facts.rotation_alone or ambiguous else poses[0].probability,
        any_probability=any_right,
        alternatives=alternatives,
        hypotheses=tuple(assessed.hypotheses),
        warnings=tuple(dict.fromkeys((*warnings, *verdict.warnings, *of_focals, *of_others))),
    )


def _explaining(assessed: Assessment) -> list[Hypothesis]:
    """The poses that explain the matches about as well, with their probabilities, the likeliest
    first."""
    explaining = [hypothesis for hypothesis in assessed.hypotheses if hypothesis.likely]
    if second := assessed.second:  # nothing shows whose motion is the camera's
        explaining = [
            replace(h, share=h.share / 2) for h in explaining if not known(second, [h.model])
        ]
        explaining.append(Hypothesis(second, True, math.nan, None, 0.5))
    any_right = assessed.probability
    if any_right is None:
        return explaining
    return [replace(h, probability=any_right * h.share) for h in explaining]


def fitted_cameras(assessed: Assessment) -> tuple[Camera, Camera]:
    """Fitted cameras with the standard deviations that are left; exact ones as they are."""
    fitted = []
    for number, camera in enumerate(assessed.cameras):
        if not camera.focal_std:
            fitted.append(camera)
            continue
        std = camera.focal_std
        if assessed.covariance is not None:
            std = calibrated_focal_std(assessed.covariance.focal_stds[number])
        fitted.append(replace(camera, focal_std=std, focal_source="matches"))
    return fitted[0], fitted[1]


def _camera_covariance(covariance: Covariance, cameras: tuple[Camera, Camera]) -> np.ndarray:
    """The calibrated covariance (6, 6) of fitted cameras, see `RelativePose`."""
    unit = []
    for camera, std in zip(cameras, covariance.focal_stds, strict=True):
        factor = calibrated_focal_std(std) / std if std else 1.0
        unit += [factor, factor * camera.focal, factor * camera.focal]
    return covariance.cameras * np.outer(unit, unit)


def _warnings_of(alternatives: int) -> tuple[str, ...]:
    if not alternatives:
        return ()
    others = "1 other pose explains" if alternatives == 1 else f"{alternatives} other poses explain"
    return (f"{others} the matches about as well: see the alternatives",)
