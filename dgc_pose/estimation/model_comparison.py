"""The camera model that the matches agree with.

The quadratic approximation of the cost at one fit, by the pose and by all parameters of both
cameras, estimates every model with the same lenses by one solve. A model is fitted only while its
estimate is the likeliest of all. Where the assumed cameras are unusual, or leave matches
unexplained, or another model wins, there are further estimates, at the fit of cameras with
everything open and at that of the winner, and the models that may be far are fitted too.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass, replace

import cv2
import numpy as np

from dgc_pose.cameras.camera import image_size
from dgc_pose.cameras.prior import FAR_OFF, USUAL_K, from_middle, has_usual_pixels, improbability
from dgc_pose.estimation.camera_changes import Cameras, are_stated, opened
from dgc_pose.estimation.camera_fit import (
    MOST_ERROR,
    ROUGH_ITERATIONS,
    JointFit,
    JointPose,
    focal_parameters,
    rough_pose,
    start_at,
)
from dgc_pose.estimation.camera_model import EXPLAINED_BY_K, other_models
from dgc_pose.estimation.intrinsics_prior import FOCALS, SIZE, IntrinsicsPrior
from dgc_pose.estimation.least_squares import cauchy_losses, loss_width
from dgc_pose.estimation.model_fit import ModelFit, Quadratic, assumed_fit, joined
from dgc_pose.estimation.probability import RIGHT_DEG, choice_shares
from dgc_pose.estimation.problem import TwoViewProblem, normalised_pixel
from dgc_pose.estimation.robust_fit import draw, run_seeds
from dgc_pose.geometry.epipolar import unit_rays
from dgc_pose.metrics import rotation_error_deg, translation_error_deg

_SAMPLED = 500  # matches
# Most matches that a sampled match stands for, if K is stated. Further effects of lenses and
# shutters are in all matches, and another camera would explain a part of these effects.
_MOST_WEIGHT = 6.0
_MOST_GROWTH = 3.0  # of the information of the matches, by further steps; docs/experiments.md
_ITERATIONS = 120  # of a RANSAC run at most
_LIMITS = (3.0, 3.0, 1.0, 1.0)  # largest errors in each round of a fit, thresholds
_MIN_SHOWN = 0.02  # least probability of a model that counts against the pose of another
# Probabilities above which the assumed cameras, and those that K states, are kept.
_MIN_SHARE = 0.25
_MIN_STATED_SHARE = 0.05
# Without a K, another model may raise the cost of the assumed cameras' inliers by the first number;
# by any if it has this many times as many inliers.
_MAX_EXTRA_COST = 1.0
_MORE = 1.2
# Standard deviations from the prior, and the least one, of ln f of another model.
_MOST_STDS = 3.0
_LEAST_FOCAL_STD = 0.1
_WORSE = 4.0  # loss by which a run may be worse than the fit of the assumed cameras
_USUAL = 0.7  # standard deviations up to which fitted focal lengths are usual
_MARGIN = 3.0  # by which an estimate may be too low, without a K
_MARGIN_OF_K = 5.0  # with a K
_DETERMINED = 0.3  # share of the prior's deviation of ln f below which the matches determine f
_LEAST_SPREAD_DEG = 1.0  # least standard deviation of the pose of a model
_ALL = IntrinsicsPrior(np.eye(2 * SIZE))


def likeliest_model(problem: TwoViewProblem, pose: JointPose) -> ModelFit:
    """The most probable model. problem: normalised by the stated cameras. pose: fitted with
    them."""
    stated = problem.cameras
    sample = _Sample.of(problem, pose)
    assumed = sample.valued(assumed_fit(stated), pose, sample.joint)
    if assumed.pose is None:
        return assumed_fit(stated, pose)
    near = sample.quadratic(sample.joint, pose)
    others = [
        near.estimate(ModelFit(model, *variant))
        for model, variant in other_models(stated)
        if model.name != "tail" or not _is_determined(assumed)
    ]
    fits = sample.compared(assumed, others)
    best = sample.settled(fits)
    shares = choice_shares([fit.log_probability for fit in fits]).tolist()
    if shares[0] > (_MIN_STATED_SHARE if are_stated(stated) else _MIN_SHARE):
        best = assumed
    elif best.model.name == "picture" and sample.confirms_K(best):
        best = assumed
    times = min(_MOST_GROWTH, max(1.0, _most_weight(stated) / sample.weight))
    return _with_others(best, fits, shares, near.doubt(assumed, others, times))


def _is_determined(assumed: ModelFit) -> bool:
    """Whether the matches determine the focal lengths, and the tail of a prior is no model."""
    before = max(camera.focal_std for camera in assumed.cameras)
    return assumed.focal_std <= _DETERMINED * before


def _with_margin(fit: ModelFit) -> float:
    margin = _MARGIN_OF_K if fit.model.contradicts_K else _MARGIN
    return fit.log_probability + (0.0 if fit.is_fitted else margin)


def _with_others(
    best: ModelFit, fits: Sequence[ModelFit], shares: Sequence[float], doubt: float
) -> ModelFit:
    """The likeliest model with the uncertainty of its pose by the other models."""
    assert best.pose is not None  # because its evidence is finite
    covariance = np.zeros((6, 6))
    agreement = 0.0
    for share, fit in zip(shares, fits, strict=True):
        if fit is best or fit.pose is None or share < _MIN_SHOWN:
            agreement += share
            continue
        R = fit.pose.R
        t = fit.pose.t
        angle = max(rotation_error_deg(R, best.pose.R), translation_error_deg(t, best.pose.t))
        own = math.degrees(math.sqrt(max(np.linalg.eigvalsh(fit.covariance)[-1], 0.0)))
        spread = min(max(own, _LEAST_SPREAD_DEG), RIGHT_DEG)
        right = 0.5 * math.erfc((angle - RIGHT_DEG) / spread / math.sqrt(2))
        agreement += share * right
        if share * right >= _MIN_SHOWN:
            rotation = cv2.Rodrigues(R @ best.pose.R.T)[0][:, 0]
            difference = np.concatenate([rotation, t - best.pose.t])
            covariance += share * right * (np.outer(difference, difference) + fit.covariance)
    return replace(best, pose_covariance=covariance, agreement=min(agreement, 1.0), doubt=doubt)


def _most_weight(cameras: Cameras) -> float:
    return _MOST_WEIGHT if are_stated(cameras) else 1.0


@dataclass(frozen=True, eq=False)
class _Sample:
    """Some of the matches, and their errors with the assumed cameras."""

    joint: JointFit  # of the assumed cameras
    pose: JointPose  # the fit of the assumed cameras
    pixels: float  # the threshold
    weight: float  # of each match, which stands for others
    error: np.ndarray  # (N,), see `_errors`
    width: float  # of the losses

    @classmethod
    def of(cls, problem: TwoViewProblem, pose: JointPose) -> _Sample:
        """A sample of the matches of a problem. pose: of the assumed cameras."""
        stated = problem.cameras
        options = problem.options
        drawn = problem.matches.subset(np.sort(draw(problem, options.seed, _SAMPLED).index))
        weight = min(max(len(problem) / max(len(drawn), 1), 1.0), _most_weight(stated))
        sampled = TwoViewProblem.of(drawn, *stated, replace(options, iterations=_ITERATIONS))
        joint = JointFit(sampled)
        pixels = problem.threshold_px
        error = _errors(joint, pose, pixels)
        near = error[error < 1]
        width = loss_width(near, 1.0) if len(near) else 1.0
        joint = JointFit(sampled, _width_for(stated, width * pixels))
        return cls(joint, pose, pixels, weight, error, width)

    def quadratic(self, joint: JointFit, pose: JointPose) -> Quadratic:
        """The approximation at a fit."""
        loss = self.weight * float(
            cauchy_losses(_errors(joint, pose, self.pixels), self.width).sum()
        )
        slopes = joint.slopes(pose, _ALL)
        return Quadratic(
            joint.problem.cameras,
            pose,
            joint.parameters(pose),
            loss,
            self.weight * slopes.hessian,
            self.weight * slopes.gradient,
        )

    def _joint_of(self, cameras: Cameras) -> JointFit:
        problem = self.joint.problem.with_cameras(cameras)
        return JointFit(problem, _width_for(cameras, self.width * self.pixels))

    def compared(self, assumed: ModelFit, others: Sequence[ModelFit]) -> list[ModelFit]:
        """The assumed model and the others, each of which is fitted while its estimate is the
        likeliest. Where one of them wins, without a K by its estimate, or the assumed cameras are
        unusual or leave matches unexplained, all are searched."""
        fits = [assumed, *others]
        explained = float((self.error < 1).mean())
        usual = self._is_usual(assumed.cameras)
        if are_stated(assumed.cameras):
            is_contested = self.settled(fits) is not assumed
        else:
            is_contested = max(fits, key=lambda fit: fit.log_probability) is not assumed
        if (
            is_contested
            or explained <= EXPLAINED_BY_K
            or (are_stated(assumed.cameras) and not usual)
        ):
            joint = self._joint_of(opened(assumed.cameras))
            wide = rough_pose(joint)
            if wide is not None:
                far = self.quadratic(joint, wide)
                fits[1:] = [joined(fit, far.estimate(fit)) for fit in fits[1:]]
        for number, fit in enumerate(fits[1:], start=1):
            is_searched = is_contested or fit.model.is_searched(
                fit.log_odds, explained=explained, usual=usual
            )
            if is_searched:
                fits[number] = self.fitted(fit, search=True)
        best = self.settled(fits)
        if best.pose is not None and best is not fits[0]:  # others may have a fit near to it
            joint = self._joint_of(best.cameras)
            there = self.quadratic(joint, best.pose)
            fits[1:] = [
                fit if fit is best else joined(fit, there.estimate(fit)) for fit in fits[1:]
            ]
        return fits

    def settled(self, fits: list[ModelFit]) -> ModelFit:
        """The likeliest of the models, each of which is fitted while its estimate is the likeliest;
        replaces the estimates in the list."""
        while not (best := max(fits, key=_with_margin)).is_fitted:
            fits[fits.index(best)] = self.fitted(best)
        return max(fits, key=lambda fit: fit.log_probability)

    def _is_usual(self, assumed: Cameras) -> bool:
        if are_stated(assumed):
            return max(map(improbability, assumed)) < USUAL_K
        focals = self.joint.prior.basis[FOCALS] @ self.pose.z
        stds = np.linalg.norm(self.joint.prior.basis[FOCALS], axis=1)
        return bool((np.abs(focals) <= _USUAL * stds).all())

    def confirms_K(self, picture: ModelFit) -> bool:
        """Whether the focal lengths are all that is improbable of K, and the cameras as without K,
        whose focal lengths the matches determine, agree with them: a telescope."""
        assert picture.pose is not None
        if picture.focal_std > _DETERMINED:
            return False
        joint = self._joint_of(picture.cameras)
        off = joint.parameters(picture.pose)[FOCALS]
        return all(
            has_usual_pixels(K)
            and from_middle(K) <= FAR_OFF
            and abs(math.log(K.focal / before.focal) - change) < 2 * picture.focal_std
            for K, before, change in zip(
                self.joint.problem.cameras, picture.cameras, off, strict=True
            )
        )

    def fitted(self, fit: ModelFit, *, search: bool = False) -> ModelFit:
        """The model with the likeliest of its fits, from its estimate or from the pose of the
        assumed cameras. search: whether also from RANSAC."""
        joint = self._joint_of(fit.cameras)
        starts = [*fit.starts]
        if search or not starts:
            starts.append(self._turned(fit.cameras, joint))
        run = self._best_run(fit, joint) if search else None
        if run is not None:
            starts.append(run)
        failed = replace(fit, pose=None, log_evidence=-math.inf, is_fitted=True)
        if len(starts) > 1:
            rough = [joint.fitted(start, _LIMITS[:1], ROUGH_ITERATIONS) for start in starts]
            best = max(rough, key=lambda pose: self.valued(failed, pose, joint).log_evidence)
        else:
            best = starts[0]
        found = self.valued(failed, joint.fitted(best, _LIMITS), joint)
        return replace(found, starts=() if found.pose is None else (found.pose,))

    def _turned(self, cameras: Cameras, joint: JointFit) -> JointPose:
        """The pose of the assumed cameras, with the middles of the images where they were."""
        own = _to_middles(self.joint.problem.cameras)
        others = _to_middles(cameras)
        turn1, turn2 = (other @ one.T for one, other in zip(own, others, strict=True))
        return JointPose(
            turn2 @ self.pose.R @ turn1.T, turn2 @ self.pose.t, np.zeros(len(joint.prior))
        )

    def _best_run(self, fit: ModelFit, joint: JointFit) -> JointPose | None:
        """The best of RANSAC runs at the focal lengths of the model; None if it has none, or none
        that explains the matches nearly as well as the assumed cameras."""
        seeds = run_seeds(joint.problem.options, max(len(fit.model.focals), 1))
        runs = [
            start_at(joint, focal_parameters(np.full(2, log_focal)), seed)
            for log_focal, seed in zip(fit.model.focals, seeds, strict=False)
        ]
        best = None
        least = float(cauchy_losses(self.error, 1.0).sum()) + _WORSE
        for run in runs:
            if run is None:
                continue
            loss = float(cauchy_losses(_errors(joint, run, self.pixels), 1.0).sum())
            if loss < least:
                best = run
                least = loss
        return best

    def valued(self, fit: ModelFit, pose: JointPose, joint: JointFit) -> ModelFit:
        """The model fitted with a pose, and its evidence. If its focal lengths are far from their
        prior, or if without a K it explains the inliers of the assumed cameras worse than these do
        and has not far more inliers, the model without a pose."""
        error = _errors(joint, pose, self.pixels)
        losses = cauchy_losses(error, self.width)
        fit = replace(fit, is_fitted=True)
        is_worse = False
        if not fit.model.contradicts_K:
            near = self.error < 1
            has_more = (error < 1).sum() >= _MORE * near.sum()
            before = cauchy_losses(self.error[near], self.width)
            most = before.sum() + _MAX_EXTRA_COST
            is_worse = losses[near].sum() > most and not has_more
        focals = joint.parameters(pose)[FOCALS]
        stds = np.maximum(np.linalg.norm(joint.prior.basis[FOCALS], axis=1), _LEAST_FOCAL_STD)
        is_far = bool((np.abs(focals) > _MOST_STDS * stds).any())
        if is_worse or (is_far and fit.model.name != "assumed"):
            return fit
        hessian = joint.slopes(pose, joint.prior).hessian
        loss = self.weight * float(losses.sum())
        return fit.with_evidence(pose, loss, self.weight * hessian)


def _width_for(cameras: Cameras, pixels: float) -> float:
    """A width in pixels, in the unit of the points that these cameras normalise."""
    return pixels * normalised_pixel(cameras)


def _errors(joint: JointFit, pose: JointPose, pixels: float) -> np.ndarray:
    """Errors (N,) of all matches in the images, over a threshold in pixels, cut off."""
    error = np.full(len(joint.problem.matches), MOST_ERROR)  # where a distortion is not undone
    error[joint.problem.index] = joint.errors_px(pose) / pixels
    return np.minimum(error, MOST_ERROR)


def _to_middles(cameras: Cameras) -> list[np.ndarray]:
    """For each camera, the rotation (3, 3) of the optical axis to the ray of the image's middle."""
    rotations = []
    for camera in cameras:
        middle = (np.array(image_size(camera)) - 1) / 2
        ray = unit_rays(camera.normalise(middle[None]))[0]
        axis = np.array([-ray[1], ray[0], 0.0])
        sine = float(np.hypot(*axis[:2]))
        if sine > 0 and math.isfinite(sine):  # not where a distortion is not undone
            axis *= math.atan2(sine, ray[2]) / sine
        else:
            axis[:] = 0.0
        rotations.append(cv2.Rodrigues(axis)[0])
    return rotations
