"""Which camera the matches agree with, where no K states it: the one that is assumed, or another.

Assumed are a pinhole with a lens of two coefficients, square pixels and the principal point near
the middle, the same in all images of a camera. The fit is repeated on some of the matches with
other cameras. A cost is minus the logarithm of the likelihood of the errors in the image and of the
camera by its prior, so that the costs of all models can be compared.
"""

from __future__ import annotations

import math
from dataclasses import dataclass, field, replace

import cv2
import numpy as np

from dgc_pose.cameras.camera import Camera
from dgc_pose.cameras.colmap_camera import CYLINDER, FISHEYE, Distortion
from dgc_pose.cameras.prior import SIZE_STD
from dgc_pose.estimation.camera_fit import MOST_ERROR, JointFit, JointPose, of_focals, start_at
from dgc_pose.estimation.evidence import ModelName
from dgc_pose.estimation.intrinsics_prior import FOCALS, is_of_part
from dgc_pose.estimation.least_squares import cauchy_losses, loss_width
from dgc_pose.estimation.options import EstimationOptions
from dgc_pose.estimation.probability import choice_shares
from dgc_pose.estimation.problem import TwoViewProblem
from dgc_pose.estimation.robust_fit import draw, run_seeds
from dgc_pose.matches import Matches
from dgc_pose.system.threads import in_threads

_SAMPLED = 300  # matches
_ITERATIONS = 120  # of a RANSAC run at most
# Of the errors of the rounds of a fit, thresholds: from a start, and from a fit.
_OF_START, _OF_FIT = (3.0, 1.0), (1.0, 1.0)
_FIT_ITERATIONS = 12  # of a round
# Logarithms of the odds of another model before the matches are seen: of a picture with EXIF data,
# of one without, and of one that no sensor has the shape of, which was cut, squeezed or joined.
_LOG_ODDS_OF_EXIF, _LOG_ODDS, _LOG_ODDS_OF_SHAPE = -15.0, -3.0, -1.0
_MIN_SHOWN = 0.02  # probability of a model that the expected errors contain
_MIN_SHARE = 0.25  # probability of the assumed cameras, with which they are kept
_SHAPES = (5 / 4, 4 / 3, 3 / 2, 8 / 5, 16 / 9)  # of sensors: the longer side over the shorter
_SAME_SHAPE = 0.015  # difference of two shapes' logarithms
_AS_WELL = 1.0  # of the cost, that the inliers of the assumed cameras may cost more
# Share of the sample below the threshold, and width of its errors in thresholds, with which nothing
# is searched far from the assumed cameras.
_EXPLAINED, _CLOSE = 0.97, 0.2
_WORSE = 8.0  # of the cost, that a start may be worse than the fit of the assumed cameras
_ASPECT_STD = 0.4  # of ln fy / fx of squeezed pixels
_CENTRE_STD = 0.02  # of the principal point of a part of an image, over the longer side
# The projections; without EXIF data focal lengths over the longer side, and the deviations of their
# logarithms.
_WIDE = {"fisheye": (FISHEYE, 0.55, 0.35), "cylinder": (CYLINDER, 0.6, 0.4)}
_STEPS = np.linspace(-1.5, 1.5, 6)  # standard deviations of ln f that are tried


@dataclass(frozen=True, eq=False)
class CameraModel:
    """Two cameras by one model."""

    name: ModelName
    cameras: tuple[Camera, Camera]  # before the fit
    pose: JointPose | None = None  # the fit; None if it failed
    cost: float = math.inf
    # (6, 6), rad^2: by how much the poses of the other models differ, by their probabilities.
    pose_covariance: np.ndarray = field(default_factory=lambda: np.zeros((6, 6)))


def likeliest_model(
    problem: TwoViewProblem,
    matches: Matches,
    stated: tuple[Camera, Camera],
    pose: JointPose,
    options: EstimationOptions,
) -> CameraModel:
    """The most probable model; of cameras that are stated, the assumed one.

    problem: of the matches, normalised by the cameras as stated. pose: fitted with these.
    """
    assumed = CameraModel("assumed", stated, pose=pose)
    if not any(map(_is_open, stated)):
        return assumed
    drawn = matches.subset(np.sort(draw(problem, options.seed, _SAMPLED).index))
    pixels = problem.threshold * (stated[0].focal + stated[1].focal) / 2
    sample = _Sample(drawn, pixels, replace(options, iterations=_ITERATIONS))
    joint = sample.joint(stated)
    error = sample.errors(joint, pose)
    near = error[error < 1]
    width = loss_width(near, 1.0) if len(near) else 1.0
    cost = float(cauchy_losses(error, width).sum() + pose.z @ pose.z / 2)
    assumed = replace(assumed, cost=cost)
    names: tuple[ModelName, ...] = ("squeezed", "off_centre", "fisheye", "cylinder")
    if any(camera.focal_source == "exif" for camera in stated):
        names += ("zoomed",)
    others = [
        CameraModel(name, (with_model(stated[0], name), with_model(stated[1], name)))
        for name in names
    ]
    at = joint.parameters(pose)
    fits = in_threads(lambda model: sample.fitted(model, pose, at, error, width), others)
    models = [assumed, *fits]
    before = max(map(_log_odds, stated))
    odds = np.array([assumed.cost - model.cost + before for model in models])
    odds[0] = 0.0
    shares = choice_shares(odds)
    best = assumed if shares[0] > _MIN_SHARE else models[int(np.argmax(shares))]
    assert best.pose is not None  # of a finite cost
    covariance = np.zeros((6, 6))
    for share, model in zip(shares, models, strict=True):
        if model is best or model.pose is None or share < _MIN_SHOWN:
            continue
        rotation = cv2.Rodrigues(model.pose.R @ best.pose.R.T)[0][:, 0]
        difference = np.concatenate([rotation, model.pose.t - best.pose.t])
        covariance += share * np.outer(difference, difference)
        own = sample.joint(model.cameras).covariance(model.pose, drawn, options)
        if own is not None:
            covariance += share * own[0]
    return replace(best, pose_covariance=covariance)


@dataclass(frozen=True, eq=False)
class _Sample:
    """Some of the matches."""

    matches: Matches
    pixels: float  # the threshold
    options: EstimationOptions  # of RANSAC

    def joint(self, cameras: tuple[Camera, Camera]) -> JointFit:
        """The fit of two cameras."""
        return JointFit(TwoViewProblem.of(self.matches, *cameras, self.options), cameras)

    def errors(self, joint: JointFit, pose: JointPose) -> np.ndarray:
        """Errors in the image of all matches (N,), thresholds, cut off."""
        error = np.full(len(self.matches), MOST_ERROR)  # also where a distortion cannot be undone
        error[joint.problem.index] = joint.errors_px(pose) / self.pixels
        return np.minimum(error, MOST_ERROR)

    def fitted(
        self, model: CameraModel, pose: JointPose, at: np.ndarray, error: np.ndarray, width: float
    ) -> CameraModel:
        """The model with the likeliest of its fits. pose: with the assumed cameras, which deviate
        by `at` (2 * SIZE,). error: (N,), with these. width: of the losses."""
        joint, near = self.joint(model.cameras), error < 1
        is_explained = near.mean() > _EXPLAINED and width < _CLOSE
        starts = [] if is_explained else _starts(model, at[FOCALS])
        seeds = run_seeds(replace(self.options, runs=max(1, len(starts))))
        rough, start = float(cauchy_losses(error, 1.0).sum()) + _WORSE, None
        for parameters, seed in zip(starts, seeds, strict=False):
            run = start_at(joint, parameters, self.options, seed)
            if run is None:
                continue
            loss = float(cauchy_losses(self.errors(joint, run), 1.0).sum())
            if loss < rough:
                rough, start = loss, run
        fits = [] if start is None else [joint.fitted(start, _OF_START, _FIT_ITERATIONS)]
        if model.name not in _WIDE:
            start = replace(pose, z=np.linalg.lstsq(joint.prior.basis, at, rcond=None)[0])
            fits += [start, joint.fitted(start, _OF_FIT, _FIT_ITERATIONS)]
        best, most = model, cauchy_losses(error, width)[near].sum() + _AS_WELL
        for fit in fits:
            losses = cauchy_losses(self.errors(joint, fit), width)
            cost = float(losses.sum() + fit.z @ fit.z / 2)
            # What is likelier explains the inliers of the assumed cameras as well.
            if cost < best.cost and losses[near].sum() < most:
                best = replace(model, pose=fit, cost=cost)
        return best


def model_warnings(
    name: ModelName, stated: tuple[Camera, Camera], fitted: tuple[Camera, Camera]
) -> tuple[str, ...]:
    """What is unusual about fitted cameras, a line each. stated: before the fit."""
    lines = []
    for camera in (c for before, c in zip(stated, fitted, strict=True) if _is_open(before)):
        fx, fy, (x, y) = camera.K[0, 0], camera.K[1, 1], camera.K[:2, 2]
        if name == "squeezed":
            std = camera.aspect_std
            lines.append(f"pixels that are not square, fy / fx = {fy / fx:.3f} +- {std:.3f}")
        elif name == "off_centre":
            std = camera.centre_std
            lines.append(f"a principal point of its own, ({x:.0f}, {y:.0f}) +- {std:.0f} px")
        elif name == "fisheye":
            lines.append(f"a fisheye, f = {camera.focal:.0f} px")
    return tuple(f"the matches agree with {line}" for line in dict.fromkeys(lines))


def _log_odds(camera: Camera) -> float:
    """Of another model, before the matches are seen."""
    shape = abs(math.log(camera.size[0] / camera.size[1])) if camera.size else 0.0
    if all(abs(shape - math.log(usual)) > _SAME_SHAPE for usual in _SHAPES):
        return _LOG_ODDS_OF_SHAPE
    return _LOG_ODDS if camera.focal_source == "size" else _LOG_ODDS_OF_EXIF


def _starts(model: CameraModel, focals: np.ndarray) -> list[np.ndarray]:
    """Parameters (2 * SIZE,) of the model's cameras that RANSAC is run at. focals: those of ln f
    (2,) with the assumed cameras."""
    if model.name in _WIDE:
        stds = np.array([camera.focal_std for camera in model.cameras])
        return [of_focals(k * stds) for k in _STEPS]
    if model.name == "squeezed":
        stds = np.array([camera.aspect_std for camera in model.cameras])
        return [
            of_focals(focals + fewer * np.abs(k * stds), k * stds)
            for k in (-1.5, -0.75, 0.75, 1.5)
            for fewer in (0.0, -0.5)
        ]
    if model.name == "zoomed":
        return [of_focals(focals + (-k, k)) for k in (-0.25, -0.125, 0.125, 0.25)]
    return []


def _is_open(camera: Camera) -> bool:
    """Whether nobody stated the camera."""
    return camera.focal_source != "given" and camera.distortion is None


def is_edited(camera: Camera) -> bool:
    """Whether the picture may be squeezed, or a part: no EXIF data say that a camera wrote it."""
    return _is_open(camera) and (camera.focal_source == "size" or is_of_part(camera))


def with_model(camera: Camera, name: ModelName) -> Camera:
    """A camera that is not fitted yet by another model; itself if it cannot be of that."""
    longer = max(camera.size or (0,))
    if not (is_edited(camera) if name in ("squeezed", "off_centre") else _is_open(camera)):
        return camera
    if name == "squeezed":
        return replace(camera, aspect_std=_ASPECT_STD)
    if name == "off_centre":  # of a part of an image, whose principal point is its own
        return replace(camera, centre_std=max(camera.centre_std, _CENTRE_STD * longer))
    if name == "zoomed":  # or cut, perhaps of one image, of which EXIF data say nothing
        return replace(camera, focal_std=SIZE_STD, identity=None)
    if name not in _WIDE:
        return camera
    projection, over_side, std = _WIDE[name]
    if camera.focal_source == "size":
        camera = replace(camera.with_focal(over_side * longer), focal_std=std)
    if projection == CYLINDER:
        return replace(camera, distortion=Distortion(projection), lens_std=0.0)
    return replace(camera, distortion=Distortion(projection, (0.0,) * 4))
