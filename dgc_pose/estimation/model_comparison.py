"""The camera model that the matches agree with.

The evidence of a model is the likelihood of the errors in the images with all parameters integrated
out, by a normal distribution around their fit (Laplace; MacKay 1992). It compares models of any
number of parameters. A model is not fitted if the slopes at the fit of the assumed cameras show
that it is far less likely.
"""

from __future__ import annotations

import math
from dataclasses import dataclass, replace

import cv2
import numpy as np

from dgc_pose.cameras.camera import Camera
from dgc_pose.estimation.camera_fit import (
    MOST_ERROR,
    JointFit,
    JointPose,
    of_focals,
    solved_start,
    start_at,
)
from dgc_pose.estimation.camera_model import STATED_K_MODELS, WIDE, CameraModel, other_models
from dgc_pose.estimation.intrinsics_prior import FOCALS, SIZE, IntrinsicsPrior, of_pose
from dgc_pose.estimation.least_squares import cauchy_losses, loss_width
from dgc_pose.estimation.probability import RIGHT_DEG, choice_shares
from dgc_pose.estimation.problem import TwoViewProblem, image_size
from dgc_pose.estimation.robust_fit import draw, run_seeds
from dgc_pose.geometry.epipolar import unit_rays
from dgc_pose.metrics import rotation_error_deg, translation_error_deg
from dgc_pose.system.parallel import in_threads

_SAMPLED = 500  # matches
# Most matches that a sampled match stands for, if K is stated. Further effects of lenses and
# shutters are in all matches, and another camera would explain a part of these effects.
_MOST_WEIGHT = 6.0
_ITERATIONS = 120  # of a RANSAC run at most
# Largest errors in each round of a fit, thresholds: from a start, and from a fit.
_OF_START, _OF_FIT = (3.0, 3.0, 1.0, 1.0), (1.0, 1.0, 1.0)
_FIT_ITERATIONS = 30  # of a round
_MIN_SHOWN = 0.02  # least probability of a model that the expected errors include
# Probabilities above which the assumed cameras, and those that K states, are kept.
_MIN_SHARE, _MIN_STATED_SHARE = 0.25, 0.05
# Another model may raise the cost of the assumed cameras' inliers by the first number; by any if it
# has this many times as many inliers.
_MAX_EXTRA_COST, _MORE = 1.0, 1.2
_EXPLAINED = 0.8  # share of inliers in the sample above which no distant cameras are searched
_HOPELESS = 6.0  # log-odds against another model, by the slopes, above which it is not fitted
_DOUBTFUL = -1.0  # log-odds of another model, from the matches only, above which it is searched
_UNUSUAL = 0.5  # squares of the assumed cameras' parameters above which two cameras are searched
_WORSE = 8.0  # cost by which a start may be worse than the fit of the assumed cameras
_LEAST_SPREAD_DEG = 1.0  # least standard deviation of the pose of a model
# To replace a stated K, a parameter is off by this many standard deviations, and the matches reduce
# its variance to this share of the prior's.
_LEAST_STDS, _DETERMINED = 5.0, 0.25
_MOST_STDS = 3.0  # largest deviation of a focal length from K, standard deviations of the prior
_OPEN_STD = 0.1  # deviation of ln f below which the matches determine it, whatever the prior
# The parameters of both cameras that differ from K, by model.
_TESTED = {
    "focal": FOCALS,
    "focals": FOCALS,
    "lens": [3, SIZE + 3],
    "centre": [1, 2, SIZE + 1, SIZE + 2],
}
_STEPS = np.linspace(-1.5, 1.5, 6)  # standard deviations of ln f that are tried
# Models with the lenses and middles of the assumed cameras: the slopes at that fit hold for them.
_BY_SLOPES = ("two", "squeezed", "off_centre", "focal", "focals", "lens", "centre")
_ALL = IntrinsicsPrior(np.eye(2 * SIZE))


def likeliest_model(problem: TwoViewProblem, pose: JointPose) -> CameraModel:
    """The most probable model. problem: normalised by the stated cameras. pose: fitted with
    them."""
    stated = problem.cameras
    drawn = problem.matches.subset(np.sort(draw(problem, problem.options.seed, _SAMPLED).index))
    pixels = problem.threshold * (stated[0].focal + stated[1].focal) / 2
    is_stated = all(camera.focal_source == "given" for camera in stated)
    most = _MOST_WEIGHT if is_stated else 1.0
    weight = min(max(len(problem) / max(len(drawn), 1), 1.0), most)
    fast = replace(problem.options, iterations=_ITERATIONS)
    joint = JointFit(TwoViewProblem.of(drawn, *stated, fast))
    sample = _Sample.of(joint, pose, pixels, weight)
    assumed = sample.valued(CameraModel("assumed", stated), pose, joint)
    if not math.isfinite(assumed.log_evidence):
        return replace(assumed, pose=pose)
    far = {"tail"} if assumed.focal_std < _OPEN_STD else set[str]()  # not tried
    far |= set(WIDE) if sample.is_explained else set()
    others = [model for model in other_models(stated) if model.name not in far]
    fits = in_threads(lambda model: sample.fitted(model, pose, assumed), others)
    models = [assumed, *fits]
    shares = choice_shares([model.log_evidence + model.log_odds for model in models]).tolist()
    best = models[int(np.argmax(shares))]
    least = _MIN_STATED_SHARE if best.name in STATED_K_MODELS else _MIN_SHARE
    if shares[0] > least or (best.name in STATED_K_MODELS and best.stds < _LEAST_STDS):
        best = assumed
    assert best.pose is not None  # because the evidence is finite
    covariance, agreement = np.zeros((6, 6)), 0.0
    for share, model in zip(shares, models, strict=True):
        if model is best or model.pose is None:
            agreement += share
            continue
        R, t = model.pose.R, model.pose.t
        angle = max(rotation_error_deg(R, best.pose.R), translation_error_deg(t, best.pose.t))
        own = math.degrees(math.sqrt(max(np.linalg.eigvalsh(model.covariance)[-1], 0.0)))
        spread = min(max(own, _LEAST_SPREAD_DEG), RIGHT_DEG)
        right = 0.5 * math.erfc((angle - RIGHT_DEG) / spread / math.sqrt(2))
        agreement += share * right
        if share * right >= _MIN_SHOWN:
            rotation = cv2.Rodrigues(R @ best.pose.R.T)[0][:, 0]
            difference = np.concatenate([rotation, t - best.pose.t])
            covariance += share * right * (np.outer(difference, difference) + model.covariance)
    doubt = max((fit.log_evidence - assumed.log_evidence for fit in fits), default=-math.inf)
    agreement = min(agreement, 1.0)
    return replace(best, pose_covariance=covariance, agreement=agreement, doubt=doubt)


@dataclass(frozen=True, eq=False)
class _Sample:
    """Some of the matches, and their errors with the assumed cameras."""

    joint: JointFit  # of the assumed cameras
    pixels: float  # the threshold
    weight: float  # of each match, which stands for others
    error: np.ndarray  # (N,), see `_errors`
    width: float  # of the losses
    # Hessian (17, 17) and gradient (17,) at the assumed fit by the pose and by all parameters of
    # both cameras; the axes (3, 2) of t.
    slopes: tuple[np.ndarray, np.ndarray, np.ndarray]

    @classmethod
    def of(cls, joint: JointFit, pose: JointPose, pixels: float, weight: float) -> _Sample:
        """The sample with the errors of the pose of the assumed cameras."""
        error = _errors(joint, pose, pixels)
        near = error[error < 1]
        width = loss_width(near, 1.0) if len(near) else 1.0
        hessian, gradient, tangent = joint.slopes(pose, width * joint.problem.threshold, _ALL)
        slopes = weight * hessian, weight * gradient, tangent
        return cls(joint, pixels, weight, error, width, slopes)

    @property
    def is_explained(self) -> bool:
        """Whether the assumed cameras explain so many matches that the right ones are similar."""
        return bool((self.error < 1).mean() > _EXPLAINED)

    def fitted(self, model: CameraModel, pose: JointPose, assumed: CameraModel) -> CameraModel:
        """The model with the likeliest of its fits. If the slopes at the pose of the assumed
        cameras show that it is hopeless, the estimate from the slopes instead."""
        joint = JointFit(self.joint.problem.of_cameras(model.cameras))
        own, others = [_to_middles(cameras) for cameras in (assumed.cameras, model.cameras)]
        turn1, turn2 = (other @ one.T for one, other in zip(own, others, strict=True))
        of_both = zip(assumed.cameras, model.cameras, strict=True)
        longer = np.log([one.focal / other.focal for one, other in of_both])
        at = self.joint.parameters(pose) + of_focals(longer)  # the middles stay where they are
        z = np.linalg.lstsq(joint.prior.basis, at, rcond=None)[0]
        start = JointPose(turn2 @ pose.R @ turn1.T, turn2 @ pose.t, z)
        # If there are two cameras, the fit of one has an unusual focal length.
        odd = model.name == "two" and float(pose.z @ pose.z) > _UNUSUAL
        searches = odd or not self.is_explained or model.name not in _BY_SLOPES
        if model.name in _BY_SLOPES:
            by_slopes = self._along_slopes(model, joint.prior, start)
            gain = by_slopes.log_evidence - assumed.log_evidence
            searches = searches or gain > _DOUBTFUL
            if gain + model.log_odds < -_HOPELESS and not searches:
                return by_slopes
        starts = _starts(model, self.joint.parameters(pose)) if searches else []
        seeds = run_seeds(joint.problem.options, 1 + len(starts))
        rough, best = float(cauchy_losses(self.error, 1.0).sum()) + _WORSE, None
        runs = [start_at(joint, at, seed) for at, seed in zip(starts, seeds[:-1], strict=True)]
        if searches and model.name in ("two", "focal", "focals"):
            runs.append(solved_start(joint, seeds[-1]))
        for run in runs:
            loss = math.inf
            if run is not None:
                loss = float(cauchy_losses(_errors(joint, run, self.pixels), 1.0).sum())
            if loss < rough:
                rough, best = loss, run
        fits = [] if best is None else [joint.fitted(best, _OF_START, _FIT_ITERATIONS)]
        if model.name not in WIDE:
            limits = _OF_FIT if model.name in _BY_SLOPES else _OF_START
            fits.append(joint.fitted(start, limits, _FIT_ITERATIONS))
        if model.name == "two" and searches:  # from the prior too
            start = replace(start, z=np.zeros(len(z)))
            fits.append(joint.fitted(start, _OF_START, _FIT_ITERATIONS))
        valued = [self.valued(model, fit, joint) for fit in fits]
        return max([model, *valued], key=lambda each: each.log_evidence)

    def valued(self, model: CameraModel, pose: JointPose, joint: JointFit) -> CameraModel:
        """The model with a pose and its evidence. If it explains the inliers of the assumed cameras
        worse than these do, and has not far more inliers, the model without a pose."""
        error = _errors(joint, pose, self.pixels)
        losses, before = cauchy_losses(error, self.width), cauchy_losses(self.error, self.width)
        near, has_more = self.error < 1, (error < 1).sum() >= _MORE * (self.error < 1).sum()
        if losses[near].sum() > before[near].sum() + _MAX_EXTRA_COST and not has_more:
            return model
        width = self.width * joint.problem.threshold
        hessian, _, tangent = joint.slopes(pose, width, joint.prior)
        loss = self.weight * float(losses.sum())
        return _with_evidence(model, joint.prior, pose, loss, self.weight * hessian, tangent)

    def _along_slopes(
        self, model: CameraModel, prior: IntrinsicsPrior, pose: JointPose
    ) -> CameraModel:
        """The model at the minimum of the quadratic approximation by `slopes`."""
        hessian, gradient, tangent = self.slopes
        basis = np.zeros((len(gradient), 5 + len(prior)))
        basis[:5, :5], basis[5:, 5:] = np.eye(5), prior.basis
        hessian, gradient = basis.T @ hessian @ basis, basis.T @ gradient
        gradient[5:] += pose.z
        step = -np.linalg.lstsq(hessian + prior.information, gradient, rcond=None)[0]
        R, t = cv2.Rodrigues(step[:3])[0] @ pose.R, pose.t + tangent @ step[3:5]
        moved = JointPose(R, t / np.linalg.norm(t), pose.z + step[5:])
        cost = self.weight * float(cauchy_losses(self.error, self.width).sum())
        cost += float(pose.z @ pose.z + gradient @ step - moved.z @ moved.z) / 2
        return _with_evidence(model, prior, moved, cost, hessian, tangent)


def _errors(joint: JointFit, pose: JointPose, pixels: float) -> np.ndarray:
    """Errors (N,) of all matches in the images, over a threshold in pixels, cut off."""
    error = np.full(len(joint.problem.matches), MOST_ERROR)  # where a distortion is not undone
    error[joint.problem.index] = joint.errors_px(pose) / pixels
    return np.minimum(error, MOST_ERROR)


def _to_middles(cameras: tuple[Camera, Camera]) -> list[np.ndarray]:
    """For each camera, the rotation (3, 3) of the optical axis to the ray of the image's middle."""
    rotations = []
    for camera in cameras:
        middle = (np.array(image_size(camera)) - 1) / 2
        ray = unit_rays(camera.normalise(middle[None]))[0]
        axis = np.array([-ray[1], ray[0], 0.0])  # the angle is small
        rotations.append(cv2.Rodrigues(axis)[0])
    return rotations


def _with_evidence(
    model: CameraModel,
    prior: IntrinsicsPrior,
    pose: JointPose,
    loss: float,
    hessian: np.ndarray,
    tangent: np.ndarray,
) -> CameraModel:
    """The model with a fit; without one if the fit is no minimum, or if it replaces K's focal
    lengths and the matches do not determine others. loss, hessian (5 + M, 5 + M): of the matches.
    """
    total = hessian + prior.information
    sign, log_determinant = np.linalg.slogdet(total)
    if sign <= 0:
        return model
    inverse = np.linalg.inv(total)
    evidence = -loss - float(pose.z @ pose.z) / 2 - float(log_determinant) / 2
    of_cameras = prior.basis @ inverse[5:, 5:] @ prior.basis.T
    variances, before = of_cameras.diagonal(), (prior.basis**2).sum(1)
    off, moved = math.inf, np.abs(prior.basis @ pose.z)
    if rows := _TESTED.get(model.name):
        stds = moved[rows] / np.sqrt(np.maximum(variances[rows], 1e-12))
        determined = variances[rows] < _DETERMINED * before[rows]
        off = float(stds[determined].max(initial=0.0))
        # A less certain focal length does not contradict K; no photograph has an extreme one.
        usual = moved[rows] <= _MOST_STDS * np.sqrt(before[rows])
        if rows == FOCALS and not (determined & usual).all():
            return model
    return replace(
        model,
        pose=pose,
        log_evidence=evidence,
        covariance=of_pose(inverse[:5, :5], tangent),
        stds=off,
        focal_std=float(np.sqrt(variances[FOCALS].max())),
    )


def _starts(model: CameraModel, at: np.ndarray) -> list[np.ndarray]:
    """Parameters (2 * SIZE,) of the model's cameras at which RANSAC runs. at: (2 * SIZE,) of the
    assumed cameras."""
    focals = at[FOCALS]
    stds = np.array([camera.focal_std for camera in model.cameras])
    if model.name in WIDE:
        return [of_focals(k * stds) for k in _STEPS]
    if model.name == "tail":
        return [of_focals(k * stds) for k in (-1.0, 0.0, 1.0)]
    if model.name == "squeezed":
        aspects = np.array([camera.aspect_std for camera in model.cameras])
        return [
            of_focals(focals + fewer * np.abs(k * aspects), k * aspects)
            for k in (-2.0, -1.0, 1.0, 2.0)
            for fewer in (0.0, -0.5)
        ]
    if model.name == "focal":
        return [of_focals(np.array([k, k])) for k in (-0.5, -0.25, 0.25, 0.5)]
    if model.name in ("two", "focals"):
        return [of_focals(np.array([-k, k])) for k in (-0.35, -0.18, 0.18, 0.35)]
    return [np.zeros(2 * SIZE)] if model.name in ("unlensed", "middle", "swapped") else []
