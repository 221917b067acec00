"""What the matches agree with, in words: of a camera before its fit and after; "" for nothing. Here
are the sentences that several models or other modules use; `camera_model` has the others."""

from __future__ import annotations

import math

import numpy as np

from dgc_pose.cameras.camera import Camera, image_size
from dgc_pose.cameras.prior import from_middle

_MIN_SHIFT = 0.005  # least one of a principal point, over the longer side, that is worth a warning
_FAR_SHIFT = 0.06  # distance from the middle, over the longer side, from which it has a cause
_MIN_FOCAL_ERROR = 0.08  # least error of ln f that is worth a warning


def focal_text(camera: Camera) -> str:
    """The focal length and its deviation."""
    return f"f = {camera.focal:.0f} +- {camera.focal_std * camera.focal:.0f} px"


def focal_of_prior(before: Camera, camera: Camera) -> str:
    """Of a focal length with a prior."""
    source = {"given": "K", "exif": "EXIF"}.get(before.focal_source)
    if source and before.focal_std and is_contradicted(before, camera):
        return f"{focal_text(camera)}, and {source} states {before.focal:.0f}"
    return ""


def focal(before: Camera, camera: Camera) -> str:
    """Of another focal length than K states."""
    off = abs(math.log(camera.focal / before.focal))
    far = off > 2 * camera.focal_std
    return f"{focal_text(camera)}, and K states {before.focal:.0f}" if far else ""


def centre_text(camera: Camera) -> str:
    """The principal point and its deviation."""
    x, y = camera.K[:2, 2]
    return f"({x:.0f}, {y:.0f}) +- {camera.centre_std:.0f} px"


def centre(before: Camera, camera: Camera) -> str:
    """Of another principal point than K states."""
    x, y = before.K[:2, 2]
    shift = np.abs(camera.K[:2, 2] - before.K[:2, 2]).max()
    if shift <= _MIN_SHIFT * max(image_size(before)):
        return ""
    is_far = from_middle(camera) > _FAR_SHIFT > from_middle(before)
    cause = ", as of corrected verticals, a shift lens or a crop" if is_far else ""
    return f"a principal point of {centre_text(camera)}{cause}, and K states ({x:.0f}, {y:.0f})"


def squeezed(camera: Camera) -> str:
    """Of pixels that are not square."""
    ratio = f"{camera.K[1, 1] / camera.K[0, 0]:.3f} +- {camera.aspect_std:.3f}"
    return f"pixels that are not square, fy / fx = {ratio}"


def off_centre(camera: Camera) -> str:
    """Of a crop."""
    return f"a principal point of its own, {centre_text(camera)}"


def is_contradicted(stated: Camera, fitted: Camera) -> bool:
    """Whether a fit contradicts a focal length that is stated with a deviation."""
    off = abs(math.log(fitted.focal / stated.focal))
    return off >= max(_MIN_FOCAL_ERROR, 3 * stated.focal_std)
