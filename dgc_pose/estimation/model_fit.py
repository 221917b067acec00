"""One camera model fitted to a pair, and its evidence; and the estimate of any model by the
quadratic approximation of the cost at one fit.

The evidence of a model is the likelihood of the errors in the images with all parameters integrated
out, by a normal distribution around their fit (Laplace; MacKay 1992). It compares models of any
number of parameters.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass, field, replace

import numpy as np

from dgc_pose.estimation.camera_changes import Cameras
from dgc_pose.estimation.camera_fit import JointPose
from dgc_pose.estimation.camera_model import CameraModel, model_named
from dgc_pose.estimation.intrinsics_prior import (
    FOCALS,
    IntrinsicsPrior,
    between,
    expanded,
    have_same_lens,
)
from dgc_pose.geometry.epipolar import tangent_axes


@dataclass(frozen=True, eq=False)
class ModelFit:
    """Two cameras by one model, and their pose: estimated or fitted."""

    model: CameraModel
    cameras: Cameras  # before the fit
    log_odds: float = 0.0  # prior, against the assumed model
    pose: JointPose | None = None  # None if there is none
    log_evidence: float = -math.inf
    covariance: np.ndarray = field(default_factory=lambda: np.zeros((6, 6)))  # of the pose, rad^2
    focal_std: float = 0.0  # of ln f of the less certain camera, by the fit
    is_fitted: bool = False
    starts: tuple[JointPose, ...] = ()  # estimates to fit from
    # Only of the likeliest model: the covariance (6, 6), rad^2, that the other models' poses within
    # 10 degrees of its pose add; and the probability that the right pose is within 10 degrees.
    pose_covariance: np.ndarray = field(default_factory=lambda: np.zeros((6, 6)))
    agreement: float = 1.0
    # Log-odds of the likeliest other model with the information that further steps can give.
    doubt: float = -math.inf

    @property
    def log_probability(self) -> float:
        """Up to a constant of the pair."""
        return self.log_evidence + self.log_odds

    def with_evidence(self, pose: JointPose, loss: float, hessian: np.ndarray) -> ModelFit:
        """The fit with a pose. loss, hessian (5 + M, 5 + M): of the matches, without the prior."""
        prior = IntrinsicsPrior.of(*self.cameras)
        total = hessian + prior.information
        sign, log_determinant = np.linalg.slogdet(total)
        if not (sign > 0 and math.isfinite(log_determinant)):
            return self
        inverse = np.linalg.inv(total)
        variances = prior.covariance(inverse[5:, 5:]).diagonal()
        return replace(
            self,
            pose=pose,
            log_evidence=-loss - float(pose.z @ pose.z) / 2 - float(log_determinant) / 2,
            covariance=expanded(inverse[:5, :5], tangent_axes(pose.t)),
            focal_std=math.sqrt(max(float(variances[FOCALS].max()), 0.0)),
        )


def assumed_fit(cameras: Cameras, pose: JointPose | None = None) -> ModelFit:
    """The stated or assumed cameras, not compared with others."""
    return ModelFit(model_named("assumed"), cameras, pose=pose)


@dataclass(frozen=True, eq=False)
class Quadratic:
    """The cost of the matches near a fit, to the second order in the pose and in all parameters of
    both cameras."""

    cameras: Cameras  # whose parameters these are
    pose: JointPose
    parameters: np.ndarray  # (12,) at the fit
    loss: float
    hessian: np.ndarray  # (17, 17)
    gradient: np.ndarray  # (17,)

    def estimate(self, fit: ModelFit, times: float = 1.0) -> ModelFit:
        """The model at the minimum of the approximation; unchanged if its lenses are others.
        times: the weight of the matches."""
        pairs = list(zip(self.cameras, fit.cameras, strict=True))
        if not all(have_same_lens(ours, theirs) for ours, theirs in pairs):
            return fit
        prior = IntrinsicsPrior.of(*fit.cameras)
        basis = np.zeros((17, 5 + len(prior)))
        basis[:5, :5] = np.eye(5)
        units = [theirs.focal / ours.focal for ours, theirs in pairs]
        unit = np.concatenate([[1, u, u, 1, 1, 1] for u in units])
        basis[5:, 5:] = unit[:, None] * prior.basis
        offset = np.zeros(17)
        offset[5:] = np.concatenate([between(*pair) for pair in pairs]) - self.parameters
        hessian = times * basis.T @ self.hessian @ basis
        gradient = times * basis.T @ (self.gradient + self.hessian @ offset)
        step = -np.linalg.lstsq(hessian + prior.information, gradient, rcond=None)[0]
        moved = replace(self.pose, z=np.zeros(len(prior))).moved(step)
        change = basis @ step + offset
        loss = self.loss + float(self.gradient @ change + change @ self.hessian @ change / 2)
        estimated = fit.with_evidence(moved, times * loss, hessian)
        return replace(estimated, starts=(moved,), is_fitted=False)

    def doubt(self, assumed: ModelFit, others: Sequence[ModelFit], times: float) -> float:
        """The log-odds of the likeliest other model if the matches had so many times their
        weight."""
        before = self.estimate(assumed, times).log_probability
        return max(
            (self.estimate(fit, times).log_probability - before for fit in others),
            default=-math.inf,
        )


def joined(fit: ModelFit, other: ModelFit) -> ModelFit:
    """The likelier one of two estimates of a model, with the starts of both."""
    if other is fit:  # there is no other estimate
        return fit
    likelier = max(fit, other, key=lambda each: each.log_probability)
    return replace(likelier, starts=(*fit.starts, *other.starts))
