"""The camera of an upright image by a K of its pixels as stored, or of the upright image."""

from __future__ import annotations

from dataclasses import replace
from typing import TYPE_CHECKING

import numpy as np

from dgc_pose.cameras.camera import Camera
from dgc_pose.geometry.pixels import EXCHANGING, Size, exif_turn
from dgc_pose.images.image import size_in_file

if TYPE_CHECKING:
    from dgc_pose.images.header import Header
    from dgc_pose.images.image import Image

_MAX_CENTRE_OFFSET = 0.04  # of the principal point from the middle, over the side


def upright_camera(camera: Camera, image: Image | Header) -> Camera:
    """The camera of an upright image by a K that was given, which is turned by `orientation_of`.

    It has a warning if the turn changes K, and K may be of the upright image too.
    """
    orientation = orientation_of(camera, image)
    if orientation == 1:
        return camera
    turned = camera.turned(exif_turn(orientation), size_in_file(image))
    if _fits(camera, image, None) != (True, False) and not np.array_equal(turned.K, camera.K):
        warning = (
            f"EXIF orientation {orientation} is applied, and K is turned with the image: it must "
            "refer to the pixels as stored"
        )
        turned = replace(turned, warnings=(*turned.warnings, warning))
    return turned


def orientation_of(camera: Camera, image: Image | Header, size: Size | None = None) -> int:
    """The EXIF orientation by which K is turned with its image: that of the image; 1 if K is
    certainly of the upright image, by its size, or without one by its principal point. size: that
    K is for, besides that of the camera."""
    return 1 if _fits(camera, image, size) == (False, True) else image.exif.orientation


def may_be_of(camera: Camera, image_size: Size, size: Size | None = None) -> bool:
    """Whether K may be of an image of `image_size`, rather than of one turned by 90 degrees. size:
    that K is for, besides that of the camera."""
    size = size or camera.size
    if size is not None:
        return (size[0] - size[1]) * (image_size[0] - image_size[1]) >= 0
    offsets = (camera.K[:2, 2] + 0.5) / image_size - 0.5
    return float(np.abs(offsets).max()) < _MAX_CENTRE_OFFSET


def _fits(camera: Camera, image: Image | Header, size: Size | None) -> tuple[bool, bool]:
    """Whether K may be of the pixels as stored, and of the upright image."""
    if image.exif.orientation not in EXCHANGING:
        return True, True
    return may_be_of(camera, size_in_file(image), size), may_be_of(camera, image.size, size)
