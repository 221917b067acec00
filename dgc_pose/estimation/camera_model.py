"""Which cameras the matches agree with: those that are stated or assumed, or others.

Each model is two cameras with deviations, and the odds that it has before the matches are seen. Its
evidence is the likelihood of the errors in the image with all parameters integrated out, by the
normal distribution around their fit (Laplace; MacKay 1992), so that models of any number of
parameters can be compared. A model that is far less likely along the slopes at the fit of the
first is not fitted itself.
"""

from __future__ import annotations

import math
from collections.abc import Iterator
from dataclasses import dataclass, field, replace

import cv2
import numpy as np

from dgc_pose.cameras.camera import Camera
from dgc_pose.cameras.colmap_camera import CYLINDER, FISHEYE, Distortion
from dgc_pose.cameras.focal_belief import FocalBelief
from dgc_pose.cameras.prior import CENTRE_STD, OTHER_STD, of_part
from dgc_pose.estimation.camera_fit import (
    MOST_ERROR,
    JointFit,
    JointPose,
    of_focals,
    solved_start,
    start_at,
)
from dgc_pose.estimation.evidence import ModelName
from dgc_pose.estimation.intrinsics_prior import FOCALS, SIZE, IntrinsicsPrior, is_of_part
from dgc_pose.estimation.least_squares import cauchy_losses, loss_width
from dgc_pose.estimation.options import EstimationOptions
from dgc_pose.estimation.probability import RIGHT_DEG, choice_shares
from dgc_pose.estimation.problem import TwoViewProblem, image_size
from dgc_pose.estimation.robust_fit import draw, run_seeds
from dgc_pose.matches import Matches
from dgc_pose.metrics import rotation_error_deg, translation_error_deg
from dgc_pose.system.threads import in_threads

_SAMPLED = 500  # matches
_ITERATIONS = 120  # of a RANSAC run at most
# Of the errors of the rounds of a fit, thresholds: from a start, and from a fit.
_OF_START, _OF_FIT = (3.0, 1.0), (1.0, 1.0)
_FIT_ITERATIONS = 12  # of a round
# Logarithms of the odds of another model before the matches are seen: of a picture with EXIF data,
# of one without, and of one that no sensor has the shape of, which was cut, squeezed or joined.
_LOG_ODDS_OF_EXIF, _LOG_ODDS, _LOG_ODDS_OF_SHAPE = -12.0, -6.0, -1.5
# Of two cameras whose images are of one size, and have the same EXIF data or none.
_TWO, _TWO_OF_EXIF = -2.2, -9.0
_STATED = -8.0  # of another camera than K states
_MIN_SHOWN = 0.02  # probability of a model that the expected errors contain
_MIN_SHARE = 0.25  # probability of the assumed cameras, with which they are kept
_SHAPES = (5 / 4, 4 / 3, 3 / 2, 8 / 5, 16 / 9)  # of sensors: the longer side over the shorter
_SAME_SHAPE = 0.015  # difference of two shapes' logarithms
_AS_WELL = 1.0  # of the cost, that the inliers of the assumed cameras may cost more
# Share of the sample below the threshold, and width of its errors in thresholds, with which nothing
# is searched far from the assumed cameras.
_EXPLAINED, _CLOSE = 0.97, 0.2
_HOPELESS = 6.0  # log-odds below the best, by the slopes, with which a model is not fitted
_WORSE = 8.0  # of the cost, that a start may be worse than the fit of the assumed cameras
_ASPECT_STD = 0.25  # of ln fy / fx of squeezed pixels
_CENTRE_STD = 0.02  # of the principal point of a part of an image, over the longer side
# Of other cameras than K states: ln f; the principal point over the longer side; the lens.
_STATED_STD, _STATED_CENTRE_STD, _STATED_LENS_STD = 0.5, 0.05, 0.15
_STATED_OFF = 0.01  # of the longer side, that the principal point of K is off the middle
OF_STATED: tuple[ModelName, ...] = ("focal", "focals", "lens", "centre", "unlensed", "middle")
_LEAST_SPREAD_DEG = 1.0  # standard deviation of the pose of a model
# By how many standard deviations the parameters that K states must be off, and the variance of
# each over that before the matches.
_LEAST_STDS, _DETERMINED = 4.0, 0.25
_OPEN_STD = 0.1  # of ln f, below which the matches determine it whatever was believed
_MIN_FOCAL_ERROR = 0.08  # of ln f, that is worth a warning
_UNCERTAIN_STD = 0.1  # of ln f, beyond which there is a warning
# The projections; without EXIF data focal lengths over the longer side, and the deviations of their
# logarithms.
_WIDE = {"fisheye": (FISHEYE, 0.55, 0.35), "cylinder": (CYLINDER, 0.6, 0.4)}
_STEPS = np.linspace(-1.5, 1.5, 6)  # standard deviations of ln f that are tried
_ALL = IntrinsicsPrior(np.eye(2 * SIZE))


@dataclass(frozen=True, eq=False)
class CameraModel:
    """Two cameras by one model, and their pose."""

    name: ModelName
    cameras: tuple[Camera, Camera]  # before the fit
    log_odds: float = 0.0  # before the matches are seen, over the assumed one's
    pose: JointPose | None = None  # the fit; None if it failed
    log_evidence: float = -math.inf
    covariance: np.ndarray = field(default_factory=lambda: np.zeros((6, 6)))  # of the pose, rad^2
    stds: float = math.inf  # that the cameras are off, in standard deviations of the fit
    focal_std: float = 0.0  # of ln f of the less certain camera, by the fit
    # Of the likeliest one. (6, 6), rad^2: by how much the poses of the other models differ, by
    # their probabilities, of those that are right if it is; and the probability that they are.
    pose_covariance: np.ndarray = field(default_factory=lambda: np.zeros((6, 6)))
    agreement: float = 1.0


def likeliest_model(
    problem: TwoViewProblem,
    matches: Matches,
    stated: tuple[Camera, Camera],
    pose: JointPose,
    options: EstimationOptions,
) -> CameraModel:
    """The most probable model.

    problem: of the matches, normalised by the cameras as stated. pose: fitted with these.
    """
    drawn = matches.subset(np.sort(draw(problem, options.seed, _SAMPLED).index))
    pixels = problem.threshold * (stated[0].focal + stated[1].focal) / 2
    sample = _Sample.of(drawn, pixels, replace(options, iterations=_ITERATIONS), stated, pose)
    assumed = sample.valued(CameraModel("assumed", stated), pose)
    if not math.isfinite(assumed.log_evidence):
        return replace(assumed, pose=pose)
    others = [model for model in _models(stated) if not sample.excludes(model, assumed)]
    fits = in_threads(lambda model: sample.fitted(model, pose, assumed), others)
    models = [assumed, *fits]
    shares = choice_shares([model.log_evidence + model.log_odds for model in models]).tolist()
    best, share = max(zip(models, shares, strict=True), key=lambda item: item[1])
    if shares[0] > _MIN_SHARE or (best.name in OF_STATED and best.stds < _LEAST_STDS):
        best = assumed
    assert best.pose is not None  # of a finite evidence
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
    return replace(best, pose_covariance=covariance, agreement=min(agreement, 1.0))


@dataclass(frozen=True, eq=False)
class _Sample:
    """Some of the matches, and their errors with the assumed cameras."""

    matches: Matches
    pixels: float  # the threshold
    options: EstimationOptions  # of RANSAC
    joint: JointFit  # of the assumed cameras
    error: np.ndarray = field(default_factory=lambda: np.zeros(0))  # (N,), as of `errors`
    width: float = 1.0  # of the losses
    # Hessian (17, 17) and gradient (17,) at the assumed fit by the pose and by all parameters of
    # both cameras; the axes (3, 2) of t.
    slopes: tuple[np.ndarray, np.ndarray, np.ndarray] | None = None

    @classmethod
    def of(
        cls,
        matches: Matches,
        pixels: float,
        options: EstimationOptions,
        stated: tuple[Camera, Camera],
        pose: JointPose,
    ) -> _Sample:
        """The sample with the errors of the pose of the assumed cameras."""
        joint = JointFit(TwoViewProblem.of(matches, *stated, options), stated)
        sample = cls(matches, pixels, options, joint)
        error = sample.errors(joint, pose)
        near = error[error < 1]
        width = loss_width(near, 1.0) if len(near) else 1.0
        slopes = joint.slopes(pose, width * joint.problem.threshold, _ALL)
        return replace(sample, error=error, width=width, slopes=slopes)

    def errors(self, joint: JointFit, pose: JointPose) -> np.ndarray:
        """Errors in the image of all matches (N,), thresholds, cut off."""
        error = np.full(len(self.matches), MOST_ERROR)  # also where a distortion cannot be undone
        error[joint.problem.index] = joint.errors_px(pose) / self.pixels
        return np.minimum(error, MOST_ERROR)

    @property
    def is_explained(self) -> bool:
        """Whether the assumed cameras explain the matches so well that others are near them."""
        return bool((self.error < 1).mean() > _EXPLAINED and self.width < _CLOSE)

    def excludes(self, model: CameraModel, assumed: CameraModel) -> bool:
        """Whether a model is no other one, or too far away."""
        if model.name == "tail":
            return assumed.focal_std < _OPEN_STD
        return model.name in _WIDE and self.is_explained

    def fitted(self, model: CameraModel, pose: JointPose, assumed: CameraModel) -> CameraModel:
        """The model with the likeliest of its fits, or as the slopes at the pose of the assumed
        cameras have it, if that is hopeless."""
        near_assumed = all(
            np.array_equal(own.K, other.K) and own.distortion == other.distortion
            for own, other in zip(model.cameras, assumed.cameras, strict=True)
        )
        joint = JointFit(
            TwoViewProblem.of(self.matches, *model.cameras, self.options), model.cameras
        )
        z = np.zeros(len(joint.prior))
        if near_assumed:
            z = np.linalg.lstsq(joint.prior.basis, self.joint.parameters(pose), rcond=None)[0]
            by_slopes = self._along_slopes(model, joint.prior, replace(pose, z=z))
            odds = by_slopes.log_evidence + model.log_odds - assumed.log_evidence
            if self.is_explained and odds < -_HOPELESS:
                return by_slopes
        starts = (
            []
            if self.is_explained and near_assumed
            else _starts(model, self.joint.parameters(pose))
        )
        seeds = run_seeds(replace(self.options, runs=1 + len(starts)))
        rough, start = float(cauchy_losses(self.error, 1.0).sum()) + _WORSE, None
        runs = [
            start_at(joint, at, self.options, seed)
            for at, seed in zip(starts, seeds[:-1], strict=True)
        ]
        if model.name in ("two", "focal", "focals") and not self.is_explained:
            runs.append(solved_start(joint, self.options, seeds[-1]))
        for run in runs:
            loss = math.inf
            if run is not None:
                loss = float(cauchy_losses(self.errors(joint, run), 1.0).sum())
            if loss < rough:
                rough, start = loss, run
        fits = [] if start is None else [joint.fitted(start, _OF_START, _FIT_ITERATIONS)]
        if model.name not in _WIDE:
            limits = _OF_FIT if near_assumed else _OF_START
            fits.append(joint.fitted(replace(pose, z=z), limits, _FIT_ITERATIONS))
        valued = [self.valued(model, fit, joint) for fit in fits]
        return max([model, *valued], key=lambda each: each.log_evidence)

    def valued(
        self, model: CameraModel, pose: JointPose, joint: JointFit | None = None
    ) -> CameraModel:
        """The model with a pose and its evidence; without one if the inliers of the assumed cameras
        are not explained as well, as they are by what is likelier."""
        joint = joint or self.joint
        losses, before = (
            cauchy_losses(error, self.width) for error in (self.errors(joint, pose), self.error)
        )
        near = self.error < 1
        if losses[near].sum() > before[near].sum() + _AS_WELL:
            return model
        width = self.width * joint.problem.threshold
        hessian, _, tangent = joint.slopes(pose, width, joint.prior)
        return _with_evidence(model, joint.prior, pose, float(losses.sum()), hessian, tangent)

    def _along_slopes(
        self, model: CameraModel, prior: IntrinsicsPrior, pose: JointPose
    ) -> CameraModel:
        """The model at the minimum of the quadratic function that the slopes determine."""
        assert self.slopes is not None
        hessian, gradient, tangent = self.slopes
        basis = np.zeros((len(gradient), 5 + len(prior)))
        basis[:5, :5], basis[5:, 5:] = np.eye(5), prior.basis
        hessian, gradient = basis.T @ hessian @ basis, basis.T @ gradient
        of_prior = np.diag([*np.zeros(5), *np.ones(len(prior))])
        gradient[5:] += pose.z
        step = -np.linalg.lstsq(hessian + of_prior, gradient, rcond=None)[0]
        R, t = cv2.Rodrigues(step[:3])[0] @ pose.R, pose.t + tangent @ step[3:5]
        moved = JointPose(R, t / np.linalg.norm(t), pose.z + step[5:])
        cost = float(cauchy_losses(self.error, self.width).sum() + pose.z @ pose.z / 2)
        cost += float(gradient @ step) / 2 - float(moved.z @ moved.z) / 2
        return _with_evidence(model, prior, moved, cost, hessian, tangent)


def _with_evidence(
    model: CameraModel,
    prior: IntrinsicsPrior,
    pose: JointPose,
    loss: float,
    hessian: np.ndarray,
    tangent: np.ndarray,
) -> CameraModel:
    """The model with a fit. loss: of the matches; hessian (5 + M, 5 + M): of that."""
    total = hessian + np.diag([*np.zeros(5), *np.ones(len(pose.z))])
    sign, log_determinant = np.linalg.slogdet(total)
    if sign <= 0:
        return model
    inverse, expand = np.linalg.inv(total), np.zeros((6, 5))
    expand[:3, :3], expand[3:, 3:] = np.eye(3), tangent
    evidence = -loss - float(pose.z @ pose.z) / 2 - float(log_determinant) / 2
    off, of_cameras = math.inf, inverse[5:, 5:]
    if len(pose.z):  # nothing is off by what the matches do not determine
        off = math.sqrt(max(float(pose.z @ np.linalg.solve(of_cameras, pose.z)), 0.0))
        off *= bool((of_cameras.diagonal() < _DETERMINED).all())
    covariance = expand @ inverse[:5, :5] @ expand.T
    of_all = prior.basis @ of_cameras @ prior.basis.T
    return replace(
        model,
        pose=pose,
        log_evidence=evidence,
        covariance=covariance,
        stds=off,
        focal_std=float(np.sqrt(of_all.diagonal()[FOCALS].max())),
    )


def _models(stated: tuple[Camera, Camera]) -> Iterator[CameraModel]:
    """The models beside the assumed one."""
    if any(map(_is_open, stated)):
        before = max(map(_log_odds, stated))
        names: tuple[ModelName, ...] = ("squeezed", "off_centre", "fisheye", "cylinder")
        for name in names:
            yield CameraModel(
                name, (with_model(stated[0], name), with_model(stated[1], name)), before
            )
        yield from _other_focals(stated)
    elif all(camera.focal_source == "given" for camera in stated):
        yield from _others_than_stated(stated)


def _other_focals(stated: tuple[Camera, Camera]) -> Iterator[CameraModel]:
    """Focal lengths of the less likely part of a belief; and one of each image."""
    first, second = stated
    beliefs = [_belief(camera) for camera in stated]
    if first.identity is None or first.identity != second.identity:
        for number, belief in enumerate(beliefs):
            if belief is not None:
                usual, tail = belief.parts([belief.lines])
                cameras = [*stated]
                cameras[number] = of_part(stated[number], tail)
                odds = tail.log_weight - usual.log_weight
                yield CameraModel("tail", (cameras[0], cameras[1]), odds)
        return
    if beliefs[0] is None or beliefs[1] is None:
        return
    usual, tail = beliefs[0].parts([belief.lines for belief in beliefs if belief])
    odds = tail.log_weight - usual.log_weight
    yield CameraModel("tail", (of_part(first, tail), of_part(second, tail)), odds)
    exif = first.focal_source == "exif"
    own = [
        belief.tail.given(belief.lines) if exif else belief.parts([belief.lines])[0]
        for belief in beliefs
        if belief
    ]
    odds = (_TWO_OF_EXIF if exif else _TWO) - usual.log_weight
    odds += sum(part.log_weight for part in own)
    cameras = [replace(of_part(c, p), identity=None) for c, p in zip(stated, own, strict=True)]
    yield CameraModel("two", (cameras[0], cameras[1]), odds)


def _others_than_stated(stated: tuple[Camera, Camera]) -> Iterator[CameraModel]:
    """Other cameras than K states."""
    one = all(camera.identity == stated[0].identity is not None for camera in stated)
    for name in OF_STATED:
        cameras = tuple(with_model(camera, name) for camera in stated)
        if name == "lens" and one:
            cameras = tuple(replace(camera, identity="both") for camera in cameras)
        if any(own is not other for own, other in zip(cameras, stated, strict=True)):
            yield CameraModel(name, (cameras[0], cameras[1]), _STATED)


def camera_warnings(
    name: ModelName, stated: tuple[Camera, Camera], fitted: tuple[Camera, Camera]
) -> tuple[str, ...]:
    """What is unusual or uncertain about fitted cameras, a line each. stated: before the fit."""
    lines, loose = [], []
    for before, camera in zip(stated, fitted, strict=True):
        source = {"given": "K", "exif": "EXIF"}.get(before.focal_source)
        if source and before.focal_std and name == "assumed":
            if is_contradicted(before, camera):
                std = camera.focal_std * camera.focal
                text = f"f = {camera.focal:.0f} +- {std:.0f} px, and {source} says"
                lines.append(f"{text} {before.focal:.0f}")
                continue
        if camera.focal_std > _UNCERTAIN_STD:
            std = 100 * camera.focal_std
            loose.append(f"f = {camera.focal:.0f} px within {std:.0f} %")
        fx, fy, (x, y) = camera.K[0, 0], camera.K[1, 1], camera.K[:2, 2]
        own = f"({x:.0f}, {y:.0f})"
        if name == "squeezed" and _is_open(before):
            std = camera.aspect_std
            lines.append(f"pixels that are not square, fy / fx = {fy / fx:.3f} +- {std:.3f}")
        elif name == "off_centre" and _is_open(before):
            lines.append(f"a principal point of its own, {own} +- {camera.centre_std:.0f} px")
        elif name == "fisheye" and _is_open(before):
            lines.append(f"a fisheye, f = {camera.focal:.0f} px")
        elif name == "two" and _is_open(before):
            std = camera.focal * camera.focal_std
            lines.append(f"a focal length of each image, f = {camera.focal:.0f} +- {std:.0f} px")
        elif name in ("focal", "focals"):
            std = camera.focal * camera.focal_std
            lines.append(f"f = {camera.focal:.0f} +- {std:.0f} px, and K states {before.focal:.0f}")
        elif name == "lens" and camera.distortion is not None:
            k1, std = camera.distortion.radial[0], camera.lens_std
            states = "none" if before.distortion is None else before.distortion.model
            lines.append(f"a lens of k1 = {k1:.3f} +- {std:.3f}, and K states {states}")
        elif name == "unlensed" and before.distortion is not None:
            lines.append(f"no lens, and K states {before.distortion.model}")
        elif name in ("centre", "middle"):
            was = f"({before.K[0, 2]:.0f}, {before.K[1, 2]:.0f})"
            std = camera.centre_std
            lines.append(f"a principal point of {own} +- {std:.0f} px, and K states {was}")
    return (
        *(f"the matches agree with {line}" for line in dict.fromkeys(lines)),
        *(f"the focal length is hardly known: {line}" for line in dict.fromkeys(loose)),
    )


def is_contradicted(stated: Camera, fitted: Camera) -> bool:
    """Whether a focal length that is stated with a deviation is fitted far from it."""
    off = abs(math.log(fitted.focal / stated.focal))
    return off >= max(_MIN_FOCAL_ERROR, 3 * stated.focal_std)


def _log_odds(camera: Camera) -> float:
    """Of another model, before the matches are seen."""
    shape = abs(math.log(camera.size[0] / camera.size[1])) if camera.size else 0.0
    if all(abs(shape - math.log(usual)) > _SAME_SHAPE for usual in _SHAPES):
        return _LOG_ODDS_OF_SHAPE
    return _LOG_ODDS_OF_EXIF if camera.focal_source == "exif" else _LOG_ODDS


def _starts(model: CameraModel, at: np.ndarray) -> list[np.ndarray]:
    """Parameters (2 * SIZE,) of the model's cameras that RANSAC is run at. at: (2 * SIZE,) of the
    assumed cameras."""
    focals = at[FOCALS]
    stds = np.array([camera.focal_std for camera in model.cameras])
    if model.name in _WIDE:
        return [of_focals(k * stds) for k in _STEPS]
    if model.name == "tail":
        return [of_focals(k * stds) for k in (-1.0, 0.0, 1.0)]
    if model.name == "squeezed":
        aspects = np.array([camera.aspect_std for camera in model.cameras])
        return [
            of_focals(focals + fewer * np.abs(k * aspects), k * aspects)
            for k in (-1.5, -0.75, 0.75, 1.5)
            for fewer in (0.0, -0.5)
        ]
    if model.name in ("two", "focals"):
        return [of_focals(np.array([-k, k])) for k in (-0.25, -0.125, 0.125, 0.25)]
    return []


def _belief(camera: Camera) -> FocalBelief | None:
    """What is known of a focal length that is not fitted yet."""
    return camera.belief if camera.focal_source in ("size", "exif", "lines") else None


def _is_open(camera: Camera) -> bool:
    """Whether nobody stated the camera."""
    return camera.focal_source != "given" and camera.distortion is None


def is_edited(camera: Camera) -> bool:
    """Whether the picture may be squeezed, or a part: no EXIF data say that a camera wrote it."""
    by_picture = camera.focal_source in ("size", "lines")
    return _is_open(camera) and (by_picture or is_of_part(camera))


def with_model(camera: Camera, name: ModelName) -> Camera:
    """A camera that is not fitted yet by another model; itself if it cannot be of that."""
    width, height = image_size(camera)
    longer, lens = max(width, height), camera.distortion
    middle = np.array([width - 1, height - 1]) / 2
    if name in ("focal", "focals"):
        identity = "both" if name == "focal" else None
        std, centre_std = (
            max(camera.focal_std, _STATED_STD),
            max(camera.centre_std, CENTRE_STD * longer),
        )
        return replace(camera, focal_std=std, centre_std=centre_std, identity=identity)
    if name == "lens":
        radial = lens is None or lens.projection in ("plane", "angles")
        return replace(camera, lens_std=_STATED_LENS_STD) if radial else camera
    if name == "unlensed":
        return camera if lens is None else replace(camera, distortion=None, lens_std=0.0)
    if name == "centre":
        return replace(camera, centre_std=max(camera.centre_std, _STATED_CENTRE_STD * longer))
    if name == "middle":
        if np.abs(camera.K[:2, 2] - middle).max() < _STATED_OFF * longer:
            return camera
        K = camera.K.copy()
        K[:2, 2] = middle
        return replace(camera, K=K, centre_std=max(camera.centre_std, CENTRE_STD * longer))
    if not (is_edited(camera) if name in ("squeezed", "off_centre") else _is_open(camera)):
        return camera
    if name == "squeezed":
        return replace(camera, aspect_std=_ASPECT_STD)
    if name == "off_centre":  # of a part of an image, whose principal point is its own
        return replace(camera, centre_std=max(camera.centre_std, _CENTRE_STD * longer))
    if name == "two":  # or cut, perhaps of one image, of which EXIF data say nothing
        return replace(camera, focal_std=OTHER_STD, identity=None)
    if name not in _WIDE:
        return camera
    projection, over_side, std = _WIDE[name]
    if camera.focal_source in ("size", "lines"):
        camera = replace(camera.with_focal(over_side * longer), focal_std=std)
    if projection == CYLINDER:
        return replace(camera, distortion=Distortion(projection), lens_std=0.0)
    return replace(camera, distortion=Distortion(projection, (0.0,) * 4))
