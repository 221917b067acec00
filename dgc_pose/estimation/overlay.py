"""Matches that stay at the same pixels while others move: an overlay (a watermark, a hood), or a
background before which an object turned.

They agree on a camera that stood still, which says nothing of the scene that moves.
"""

import math
from dataclasses import replace

import numpy as np

from dgc_pose.cameras.camera import Camera
from dgc_pose.estimation.result import RelativePose
from dgc_pose.geometry.pixels import rescale
from dgc_pose.geometry.rotation import rotation_angle_deg
from dgc_pose.matches import Matches

_STAY_PX = 1.0  # that a match moves at most; or the expected error of the matches, if that is more
_NEAR = 3.0  # times that: small motions of a camera are as frequent up to here
_MIN_COUNT, _MIN_SHARE = 20, 0.04  # of the matches that stay
_MOST_ERROR_DEG = 2.0  # of R, that counts where points that stay may be far away
_MOST = 0.6  # share of the matches that stay, up to which the others decide


def staying(matches: Matches, camera1: Camera, camera2: Camera) -> np.ndarray:
    """The matches that stay at the same pixels, (N,) bool; none if these are few, or no more than
    those that move a little, as where the motion of a camera leaves a part of the image in place.
    """
    points2 = matches.points2
    if camera1.size is not None and camera2.size is not None:
        points2 = rescale(points2, camera2.size, camera1.size)
    moved = np.hypot(*(points2 - matches.points1).T) / max(_STAY_PX, matches.error_px)
    stay = moved < 1
    little = (moved >= 1) & (moved < _NEAR)
    least = max(_MIN_COUNT, _MIN_SHARE * np.isfinite(moved).sum())
    if stay.sum() < least or stay.sum() <= little.sum():
        return np.zeros(len(stay), dtype=bool)
    return stay


def are_far(pose: RelativePose, camera: Camera) -> bool:
    """Whether points that stay at the same pixels may be far away: the pose of the others turns by
    no more than a pixel and its error. camera: of image 1."""
    if pose.evidence is None or not pose.hypotheses:
        return False
    allowed = math.degrees(_STAY_PX / camera.focal)
    error = pose.evidence.raw_rotation_90_deg or 0.0
    return rotation_angle_deg(pose.hypotheses[0].R) < allowed + min(error, _MOST_ERROR_DEG)


def of_the_moving(pose: RelativePose, stay: np.ndarray) -> RelativePose:
    """The pose of the matches that move, as that of all. stay: (N,) bool, the others. Where most
    stay, the camera may have stood still as well."""
    count = int(stay.sum()) + pose.num_matches  # without those that are not finite
    part = stay.sum() / count
    share = f"{stay.sum()} of {count} matches ({100 * part:.0f} %)"
    inliers = np.zeros(len(stay), dtype=bool)
    inliers[~stay] = pose.inliers
    if part <= _MOST:
        warning = (
            f"{share} stay at the same pixels while others move, and are left out: an overlay, or "
            "a background that stood still (mask1 and mask2 exclude it from the matching)"
        )
        return replace(pose, inliers=inliers, warnings=(*pose.warnings, warning))
    reason = f"{share} stay at the same pixels"
    if not pose.success:
        reason += "" if part == 1 else ", and the others determine no pose"
        return RelativePose("same_picture", reason, inliers, count, warnings=pose.warnings)
    reason += f", and {pose.num_inliers} agree on a motion: which is the camera's does not show"
    both = (pose.hypotheses[0], *pose.alternatives)
    return RelativePose(
        "ambiguous",
        reason,
        inliers,
        count,
        probability=0.0,
        any_probability=pose.any_probability,
        same_place_probability=pose.same_place_probability,
        alternatives=both,
        hypotheses=pose.hypotheses,
        warnings=pose.warnings,
    )
