"""From matches and cameras to a relative pose, or to the plain word that there is none."""

from __future__ import annotations

import math

import numpy as np

from dgc_pose.camera import Camera
from dgc_pose.errors import InputError
from dgc_pose.estimation.backends import MINIMAL
from dgc_pose.estimation.consensus import (
    Model,
    best_model,
    best_planar_model,
    error_scale,
    planar_share,
    polished,
)
from dgc_pose.estimation.options import EstimationOptions
from dgc_pose.estimation.result import RelativePose, Status
from dgc_pose.estimation.uncertainty import error_radius_deg, pose_covariance
from dgc_pose.estimation.verdict import gather, judge
from dgc_pose.geometry.epipolar import essential_from_pose
from dgc_pose.matches import Matches

_DEFAULTS = EstimationOptions()
_CELLS = 24  # places along the longer side of an image


def estimate_pose(
    matches: Matches, camera1: Camera, camera2: Camera, options: EstimationOptions = _DEFAULTS
) -> RelativePose:
    """The pose x2 = R x1 + t of camera 2 relative to camera 1, translation up to scale.

    Each camera's lens distortion is undone and its own K applied; the threshold, in pixels of the
    originals, becomes px / focal, the mean over both cameras. The same seed gives the same answer
    to the bit.
    """
    if not isinstance(matches, Matches):
        raise InputError(f"matches must be Matches, not {type(matches).__name__}")
    used, warnings = _usable(matches)
    points1 = camera1.normalise(matches.points1[used])
    points2 = camera2.normalise(matches.points2[used])
    undone = np.isfinite(points1).all(1) & np.isfinite(points2).all(1)
    if not undone.all():
        warnings.append(f"{(~undone).sum()} matches dropped: their distortion cannot be undone")
        used = used[undone]
        points1, points2 = points1[undone], points2[undone]
    if len(used) < options.verdict.min_matches:
        reason = f"only {len(used)} matches; a verdict needs {options.verdict.min_matches}"
        return _no_pose("too_few_matches", reason, matches, len(used), warnings)

    pixels = options.threshold_px or options.threshold_factor * matches.error_px
    threshold = pixels * (1 / camera1.focal + 1 / camera2.focal) / 2
    model = best_model(points1, points2, threshold, options)
    if model is None:
        reason = f"no essential matrix was found for {len(used)} matches"
        return _no_pose("no_model", reason, matches, len(used), warnings)
    planar, H = planar_share(points1, points2, model, threshold, options.seed)
    if H is not None and planar >= options.verdict.planar_share:
        model = best_planar_model(points1, points2, model, H, threshold, options.refine)
    if options.refine:
        model = polished(points1, points2, model, threshold)
    cells = None if matches.key_points else (_cell(camera1), _cell(camera2))
    covariance = _covariance(points1, points2, model, threshold)
    evidence = gather(
        points1,
        points2,
        model,
        threshold,
        planar,
        options.seed,
        cells=cells,
        rotation_error_90_deg=_radius(covariance, slice(0, 3)),
    )
    status, reason, notes = judge(evidence, model.count, options.verdict)

    has_pose = status in ("ok", "planar")
    if not has_pose:
        covariance = None
    R = model.R if has_pose else evidence.rotation if status == "rotation_only" else None
    inliers = np.zeros(len(matches), dtype=bool)
    inliers[used] = model.inliers
    return RelativePose(
        status=status,
        success=has_pose,
        reason=reason,
        R=R,
        t=model.t if has_pose else None,
        E=essential_from_pose(model.R, model.t) if has_pose else None,
        inliers=inliers,
        num_matches=len(used),
        num_inliers=model.count,
        inlier_ratio=evidence.inlier_ratio,
        cheirality_ratio=evidence.cheirality_ratio,
        median_triangulation_angle_deg=evidence.median_angle_deg,
        homography_ratio=evidence.homography_ratio,
        covariance=covariance,
        rotation_error_90_deg=_radius(covariance, slice(0, 3)),
        translation_error_90_deg=_radius(covariance, slice(3, 6)),
        evidence=evidence,
        warnings=(*warnings, *notes),
    )


def _cell(camera: Camera) -> float:
    """The side of a place, normalised. Where the camera does not tell the image's size, it is that
    of an image with the principal point in its middle."""
    longer = max(camera.size or (2 * camera.K[0, 2] + 1, 2 * camera.K[1, 2] + 1))
    return float(longer) / _CELLS / camera.focal


def _covariance(
    points1: np.ndarray, points2: np.ndarray, model: Model, threshold: float
) -> np.ndarray | None:
    kept = model.inliers & model.in_front
    if kept.sum() <= MINIMAL:
        return None
    seen1, seen2 = points1[kept], points2[kept]
    scale = error_scale(seen1, seen2, model.R, model.t, threshold)
    return pose_covariance(seen1, seen2, model.R, model.t, scale)


def _radius(covariance: np.ndarray | None, part: slice) -> float | None:
    return None if covariance is None else error_radius_deg(covariance[part, part])


def _usable(matches: Matches) -> tuple[np.ndarray, list[str]]:
    """Indices of the finite, distinct matches, and what was dropped."""
    rows = np.column_stack([matches.points1, matches.points2])
    finite = np.isfinite(rows).all(1)
    kept = np.flatnonzero(finite)
    _, first = np.unique(rows[kept], axis=0, return_index=True)
    warnings = []
    if not finite.all():
        warnings.append(f"{(~finite).sum()} matches dropped: not finite")
    if len(first) < len(kept):
        warnings.append(f"{len(kept) - len(first)} matches dropped: duplicates")
    return kept[np.sort(first)], warnings


def _no_pose(
    status: Status, reason: str, matches: Matches, used: int, warnings: list[str]
) -> RelativePose:
    return RelativePose(
        status=status,
        success=False,
        reason=reason,
        R=None,
        t=None,
        E=None,
        inliers=np.zeros(len(matches), dtype=bool),
        num_matches=used,
        num_inliers=0,
        inlier_ratio=0.0,
        cheirality_ratio=math.nan,
        median_triangulation_angle_deg=math.nan,
        homography_ratio=math.nan,
        warnings=tuple(warnings),
    )
