"""How uncertain the likeliest pose and its cameras are."""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np

from dgc_pose.cameras.camera import Camera
from dgc_pose.estimation.candidates import Candidates
from dgc_pose.estimation.covariance import NORMAL_90, pose_covariance
from dgc_pose.estimation.evidence import FocalCheck
from dgc_pose.estimation.focal_check import check_focals
from dgc_pose.estimation.intrinsics_prior import FOCALS, SIZE, IntrinsicsPrior
from dgc_pose.estimation.options import EstimationOptions
from dgc_pose.estimation.probability import calibrated_focal_std
from dgc_pose.matches import Matches


@dataclass(frozen=True, eq=False)
class Uncertainty:
    """The uncertainty of the likeliest pose."""

    cameras: tuple[Camera, Camera]  # with the standard deviations that are left, calibrated
    check: FocalCheck | None = None  # of the focal lengths of exact cameras
    # (6, 6), see `pose_covariance`, not calibrated; None if the inliers do not determine it.
    covariance: np.ndarray | None = None
    camera_covariance: np.ndarray | None = None  # (12, 12), see `RelativePose`
    # The error of ln f of the less certain camera that nine in ten stay below, per cent, not
    # calibrated; None if both focal lengths are exact.
    focal_90_percent: float | None = None


def uncertainty(found: Candidates, matches: Matches, options: EstimationOptions) -> Uncertainty:
    """The uncertainty of the likeliest candidate and of its cameras. matches: that it is of."""
    problem, best, cameras = found.problem, found.hypotheses[0], found.model.cameras
    prior, check = IntrinsicsPrior.of(*cameras), None
    if not len(prior):  # K is to be right
        check = check_focals(problem, best, matches, cameras, options, is_plane=found.on_plane)
    covariances = pose_covariance(problem, best, prior, fitted=found.fitted)
    if found.fitted:
        first, second = (replace(c, focal_source="matches") if c.focal_std else c for c in cameras)
        cameras = first, second
    if covariances is None:
        return Uncertainty(cameras, check)
    covariance, of_cameras = covariances[0] + found.model.pose_covariance, covariances[1]
    focal_std = float(np.sqrt(of_cameras.diagonal()[FOCALS].max()))
    camera_covariance = None
    if found.fitted:
        first, unit1 = _calibrated(cameras[0], of_cameras[:SIZE, :SIZE])
        second, unit2 = _calibrated(cameras[1], of_cameras[SIZE:, SIZE:])
        cameras = first, second
        camera_covariance = of_cameras * np.outer(unit1 + unit2, unit1 + unit2)
    focal_90_percent = 100 * NORMAL_90 * focal_std or None
    return Uncertainty(cameras, check, covariance, camera_covariance, focal_90_percent)


def _calibrated(camera: Camera, covariance: np.ndarray) -> tuple[Camera, list[float]]:
    """A fitted camera with standard deviations by a covariance (6, 6), calibrated as that of the
    focal length is, and at most those that it had; and these over the raw ones of its parameters
    (6,), 0 of what is exact."""
    if camera.exact:
        return camera, [0.0] * SIZE
    focal, x, y, lens, _, aspect = covariance.diagonal().tolist()
    raw = [focal**0.5, ((x + y) / 2) ** 0.5, lens**0.5, aspect**0.5]
    factor = calibrated_focal_std(raw[0]) / raw[0] if raw[0] else 1.0
    camera = replace(
        camera,
        focal_std=min(factor * raw[0], camera.focal_std),
        centre_std=min(factor * raw[1] * camera.focal, camera.centre_std),
        lens_std=min(factor * raw[2], camera.lens_std),
        aspect_std=min(factor * raw[3], camera.aspect_std),
    )
    stds = camera.focal_std, camera.centre_std, camera.lens_std, camera.aspect_std
    by_focal, by_centre, by_lens, by_aspect = (
        std / before if before else 0.0 for std, before in zip(stds, raw, strict=True)
    )
    return camera, [by_focal, by_centre, by_centre, by_lens, by_lens, by_aspect]
