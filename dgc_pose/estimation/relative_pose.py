"""From matches and cameras to a relative pose, or to the reason why there is none."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from functools import partial

import numpy as np

from dgc_pose.cameras.camera import Camera
from dgc_pose.estimation.covariance import pose_covariance
from dgc_pose.estimation.evidence import Evidence, gather
from dgc_pose.estimation.model import Model
from dgc_pose.estimation.options import EstimationOptions
from dgc_pose.estimation.poselib_calls import sampled_models
from dgc_pose.estimation.probability import ProbabilityModel, match_kind, shipped_models
from dgc_pose.estimation.problem import TwoViewProblem
from dgc_pose.estimation.refine import best_planar_model, planar_share, refine, refit
from dgc_pose.estimation.result import Alternative, RelativePose
from dgc_pose.estimation.rivals import rivals
from dgc_pose.estimation.status import STATUSES
from dgc_pose.estimation.verdict import judge
from dgc_pose.matches import Matches
from dgc_pose.system.options import check_type

_DEFAULTS = EstimationOptions()


def estimate_pose(
    matches: Matches,
    camera1: Camera,
    camera2: Camera,
    options: EstimationOptions = _DEFAULTS,
    *,
    map_matches: Matches | None = None,
) -> RelativePose:
    """The pose x2 = R x1 + t of camera 2 relative to camera 1, translation up to scale.

    `TwoViewProblem.of` describes how matches and threshold are normalised. map_matches: an even
    sample of the dense map that the matches come from (`MatchResult.map_matches`), as evidence for
    the probability. The same seed gives the same answer to the bit. Raises InputError if `matches`
    is not Matches.
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
    runs = sampled_models(problem, options)
    if not runs:
        return failure("no_model", f"no essential matrix was found for {len(problem)} matches")

    model, homography = _refined(problem, runs[0], options)
    others = rivals(problem, model, runs, homography, options)
    map_problem = None
    if map_matches is not None:
        # A threshold in pixels is that of the matches, not of the map.
        map_options = replace(options, threshold_px=None)
        map_problem = TwoViewProblem.of(map_matches, camera1, camera2, map_options)

    def assess(model: Model, rivals: Sequence[Model]) -> _Assessed:
        covariance = pose_covariance(problem, model)
        evidence = gather(
            problem,
            model,
            homography[0],
            covariance,
            runs=runs,
            rivals=rivals,
            map_problem=map_problem,
        )
        logistic = shipped_models().get(match_kind(evidence))
        return _Assessed(model, evidence, covariance, logistic)

    best = assess(model, others)
    against = () if best.logistic is None else best.logistic.against(best.evidence)
    verdict = judge(best.evidence, options.verdict, best.probability, against)

    inliers[problem.index] = model.inliers
    known = STATUSES[verdict.status]
    rotation = best.evidence.rotation if known.rotation_alone else None
    least = options.verdict.alternative_share * model.count_in_front
    alternatives = _alternatives(
        [assess(other, [model]) for other in others if other.count_in_front >= least],
        best.probability,
    )
    return RelativePose(
        status=verdict.status,
        reason=verdict.reason,
        inliers=inliers,
        num_matches=len(problem),
        R=model.R if known.has_t else rotation,
        t=model.t if known.has_t else None,
        covariance=best.calibrated_covariance if known.has_t else None,
        camera1=camera1 if known.has_t else None,
        camera2=camera2 if known.has_t else None,
        evidence=best.evidence,
        probability=0.0 if known.rotation_alone else best.probability,
        alternatives=alternatives,
        warnings=problem.warnings + verdict.warnings + _warnings(len(alternatives)),
    )


@dataclass(frozen=True, eq=False)
class _Assessed:
    """A model with its evidence, and the logistic model of its probability if there is one."""

    model: Model
    evidence: Evidence
    covariance: np.ndarray | None
    logistic: ProbabilityModel | None

    @property
    def probability(self) -> float | None:
        return None if self.logistic is None else self.logistic.probability(self.evidence)

    @property
    def calibrated_covariance(self) -> np.ndarray | None:
        if self.covariance is None or self.logistic is None:
            return self.covariance
        return self.logistic.calibrated(self.covariance, self.evidence)


def _alternatives(
    others: Sequence[_Assessed], probability: float | None
) -> tuple[Alternative, ...]:
    """At most one of all poses is right: the alternatives share what the probability of the first
    pose leaves of 1."""
    total = sum(other.probability or 0.0 for other in others)
    share = 1.0 if probability is None else min(1.0, (1 - probability) / max(total, 1e-9))
    return tuple(
        Alternative(
            other.model.R,
            other.model.t,
            other.model.count,
            None if other.probability is None else share * other.probability,
        )
        for other in others
    )


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
