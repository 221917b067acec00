"""Which camera the matches agree with, where no K states it: the one that is assumed, or another.

Assumed are a pinhole with a lens of two coefficients, square pixels and the principal point near
the middle, the same in all images of a camera. The fit is repeated on some of the matches with
other cameras. A cost is minus the logarithm of the likelihood of the errors in the image and of the
camera by its prior, so that the costs of all models can be compared.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass, field, replace

import cv2
import numpy as np

from dgc_pose.cameras.camera import Camera
from dgc_pose.cameras.colmap_camera import CYLINDER, FISHEYE, Distortion
from dgc_pose.cameras.prior import SIZE_STD
from dgc_pose.estimation.camera_fit import MOST_ERROR, JointFit, JointPose, of_focals, start_at
from dgc_pose.estimation.camera_spread import (
    FOCALS,
    CameraSpread,
    deviating_pair,
    is_of_part,
)
from dgc_pose.estimation.covariance import pose_covariance
from dgc_pose.estimation.evidence import ModelName
from dgc_pose.estimation.hypothesis import ALIKE, EFFICIENT, Hypothesis, error_scale
from dgc_pose.estimation.options import EstimationOptions
from dgc_pose.estimation.problem import TwoViewProblem
from dgc_pose.estimation.robust_fit import run_seeds
from dgc_pose.matches import Matches
from dgc_pose.system.threads import in_threads

_SAMPLED = 300  # matches
_ITERATIONS = 120  # of a RANSAC run
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
# Share of the sample below the threshold, and scale of its errors in thresholds, with which nothing
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
    starts: Sequence[np.ndarray] = ()  # deviations (2 * SIZE,), see `CameraSpread`
    pose: JointPose | None = None  # where a fit starts as well; then the fit; None if it failed
    cost: float = math.inf
    # (6, 6), rad^2: by how much the poses of the other models differ, by their probabilities.
    pose_spread: np.ndarray = field(default_factory=lambda: np.zeros((6, 6)))


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
    order = np.random.default_rng(options.seed).permutation(len(problem))
    sample = matches.subset(problem.index[np.sort(order[:_SAMPLED])])
    pixels = problem.threshold * (stated[0].focal + stated[1].focal) / 2
    less = replace(options, iterations=_ITERATIONS)

    def joint_of(model: CameraModel) -> JointFit:
        of_model = TwoViewProblem.of(sample, *model.cameras, options)
        return JointFit(of_model, CameraSpread.of(*model.cameras))

    def errors(joint: JointFit, pose: JointPose, model: CameraModel) -> np.ndarray:
        """Errors in the image of all of the sample, thresholds, cut off."""
        error = np.full(len(sample), MOST_ERROR)  # also where a distortion cannot be undone
        focals = model.cameras[0].focal, model.cameras[1].focal
        error[joint.problem.index] = joint.errors_px(pose, focals) / pixels
        return np.minimum(error, MOST_ERROR)

    def losses(error: np.ndarray, scale: float) -> np.ndarray:
        return EFFICIENT**2 / ALIKE / 2 * np.log1p((error / scale) ** 2)

    error = errors(joint_of(assumed), pose, assumed)
    near = error < 1
    scale = error_scale(error[near], 1.0) if near.any() else 1.0
    rough, loss = losses(error, 1.0), losses(error, scale)
    assumed = replace(assumed, cost=float(loss.sum() + pose.z @ pose.z / 2))
    is_explained = near.mean() > _EXPLAINED and scale < _CLOSE

    def fitted(model: CameraModel) -> CameraModel:
        joint = joint_of(model)
        tried = () if is_explained else model.starts
        seeds = run_seeds(replace(options, runs=max(1, len(tried))))
        runs = [
            start_at(joint.problem, joint.spread, at, less, seed)
            for at, seed in zip(tried, seeds, strict=False)
        ]
        roughly = {
            float(losses(errors(joint, run, model), 1.0).sum()): run
            for run in runs
            if run is not None
        }
        fits = []
        if roughly and min(roughly) < rough.sum() + _WORSE:
            fits = [joint.fitted(roughly[min(roughly)], _OF_START, _FIT_ITERATIONS)]
        if model.pose is not None:
            deviations = CameraSpread.of(*stated).basis @ model.pose.z
            z = np.linalg.lstsq(joint.spread.basis, deviations, rcond=None)[0]
            start = replace(model.pose, z=z)
            fits += [start, joint.fitted(start, _OF_FIT, _FIT_ITERATIONS)]
        best = replace(model, pose=None)
        for fit in fits:
            of_fit = losses(errors(joint, fit, model), scale)
            cost = float(of_fit.sum() + fit.z @ fit.z / 2)
            # What is likelier explains the inliers of the assumed cameras as well.
            if cost < best.cost and of_fit[near].sum() < loss[near].sum() + _AS_WELL:
                best = replace(model, pose=fit, cost=cost)
        return best

    models = [assumed, *in_threads(fitted, _others(stated, pose))]
    before = max(map(_log_odds, stated))
    odds = np.array([assumed.cost - model.cost + before for model in models])
    odds[0] = 0.0
    shares = np.exp(odds - odds.max())
    shares /= shares.sum()
    best = assumed if shares[0] > _MIN_SHARE else models[int(np.argmax(shares))]
    spread = np.zeros((6, 6))
    for share, model in zip(shares, models, strict=True):
        if model is best or model.pose is None or share < _MIN_SHOWN:
            continue
        difference = _difference(best, model)
        spread += share * np.outer(difference, difference)
        joint = joint_of(model)
        cameras = deviating_pair(model.cameras, joint.deviations(model.pose))
        problem = TwoViewProblem.of(sample, *cameras, options)
        hypothesis = Hypothesis.of_pose(problem, model.pose.R, model.pose.t)
        own = pose_covariance(problem, hypothesis, CameraSpread.of(*cameras))
        if own is not None:
            spread += share * own.pose
    return replace(best, pose_spread=spread)


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


def _difference(model: CameraModel, other: CameraModel) -> np.ndarray:
    """(w, d) (6,) with which the other's pose is exp([w]x) R and t + d."""
    if model.pose is None or other.pose is None:
        return np.zeros(6)
    rotation = cv2.Rodrigues(other.pose.R @ model.pose.R.T)[0][:, 0]
    return np.concatenate([rotation, other.pose.t - model.pose.t])


def _others(stated: tuple[Camera, Camera], pose: JointPose) -> list[CameraModel]:
    """The other models. pose: fitted with the cameras as stated."""

    def changed(name: ModelName) -> tuple[Camera, Camera]:
        first, second = (with_model(camera, name) for camera in stated)
        return first, second

    def wide(name: ModelName) -> CameraModel:
        cameras = changed(name)
        stds = np.array([camera.focal_std for camera in cameras])
        return CameraModel(name, cameras, [of_focals(k * stds) for k in _STEPS])

    focals = CameraSpread.of(*stated).basis[FOCALS] @ pose.z
    squeezed = changed("squeezed")
    aspects = np.array([camera.aspect_std for camera in squeezed])
    others = [
        CameraModel(
            "squeezed",
            squeezed,
            [
                of_focals(focals + fewer * np.abs(k * aspects), k * aspects)
                for k in (-1.5, -0.75, 0.75, 1.5)
                for fewer in (0.0, -0.5)
            ],
            pose,
        ),
        CameraModel("off_centre", changed("off_centre"), (), pose),
        wide("fisheye"),
        wide("cylinder"),
    ]
    if any(camera.focal_source == "exif" for camera in stated):
        apart = [of_focals(focals + np.array([-k, k])) for k in (-0.25, -0.125, 0.125, 0.25)]
        others.append(CameraModel("zoomed", changed("zoomed"), apart, pose))
    return others


def _is_open(camera: Camera) -> bool:
    """Whether nobody stated the camera."""
    return camera.focal_source != "given" and camera.distortion is None


def _is_edited(camera: Camera) -> bool:
    """Whether the picture may be squeezed, or a part: no EXIF data say that a camera wrote it."""
    return _is_open(camera) and (camera.focal_source == "size" or is_of_part(camera))


def with_model(camera: Camera, name: ModelName) -> Camera:
    """A camera that is not fitted yet by another model; itself if it cannot be of that."""
    longer = max(camera.size or (0,))
    if not (_is_edited(camera) if name in ("squeezed", "off_centre") else _is_open(camera)):
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
