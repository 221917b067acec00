"""The camera of an image without a K: a focal length with its deviation, by EXIF data or the size.

The principal point is the middle of the image, whose pixels are as stored: an EXIF orientation
changes nothing.
"""

from __future__ import annotations

from dataclasses import replace
from typing import TYPE_CHECKING, Literal

import numpy as np

from dgc_pose.cameras.camera import Camera, FocalSource
from dgc_pose.cameras.exif_focal import exif_focal

if TYPE_CHECKING:
    from dgc_pose.images.header import Header
    from dgc_pose.images.image import Image

Sharing = Literal["files", "shared", "two"]
SIZE_FOCAL = 1.1  # geometric middle of the focal lengths of photographs, over the longer side
SIZE_STD = 0.45  # deviation of their logarithm
CENTRE_STD = 0.005  # of the principal point from the middle, over the longer side
_MAX_CENTRE_OFFSET = 0.04  # of the principal point from the middle, over the side
_QUARTER_TURNS = (5, 6, 7, 8)  # EXIF orientations that exchange width and height


def auto_camera(image: Image | Header) -> Camera:
    """The camera of an image without a K: its focal length by its EXIF data, else by its size.

    `identity` is equal for images that one camera may have taken: of the same size, in either
    orientation, whose EXIF data name the same camera, lens, focal length and zoom, or none. Of two
    images of which one has lost its EXIF data it is not known that one camera took both.
    """
    width, height = image.size
    longer, shorter = max(width, height), min(width, height)
    exif = image.exif
    prior = exif_focal(exif, image.size)
    names = (exif.make, exif.model, exif.lens, exif.focal_mm, exif.focal_35mm)
    identity = f"auto {longer} x {shorter}"
    if any(names):
        identity += "".join(f", {name or '-'}" for name in (*names, exif.digital_zoom))
    source: FocalSource = "size"
    focal, std = SIZE_FOCAL * longer, SIZE_STD
    if prior.focal is not None:
        source, focal, std = "exif", prior.focal, prior.std
        identity += f", {focal:.1f} px"  # parts of images of several sizes differ in nothing else
    return Camera(
        np.array([[focal, 0, (width - 1) / 2], [0, focal, (height - 1) / 2], [0, 0, 1]]),
        image.size,
        warnings=prior.warnings,
        focal_std=std,
        centre_std=float(np.hypot(CENTRE_STD * longer, prior.centre_std)),
        focal_source=source,
        identity=identity,
    )


def auto_cameras(
    image1: Image | Header, image2: Image | Header, sharing: Sharing = "files"
) -> tuple[Camera, Camera]:
    """`auto_camera` of two images.

    sharing: whether one camera took both: "files" decides by the `identity` of both. Of a "shared"
    camera the EXIF data of one image are those of the other, if that has none and is as large.
    """
    camera1, camera2 = auto_camera(image1), auto_camera(image2)
    if sharing == "files":
        return camera1, camera2
    if sharing == "two":
        return replace(camera1, identity="image1"), replace(camera2, identity="image2")
    if sorted(image1.size) == sorted(image2.size):
        best = min(camera1, camera2, key=lambda camera: camera.focal_std)
        camera1, camera2 = _with_focal(camera1, best), _with_focal(camera2, best)
    return replace(camera1, identity="shared"), replace(camera2, identity="shared")


def _with_focal(camera: Camera, other: Camera) -> Camera:
    """The camera with the focal length of another, unless it has one of EXIF data."""
    if camera.focal_source == "exif":
        return camera
    K = camera.K.copy()
    K[[0, 1], [0, 1]] = other.K[[0, 1], [0, 1]]
    return replace(camera, K=K, focal_std=other.focal_std, focal_source=other.focal_source)


def with_orientation(camera: Camera, image: Image | Header) -> Camera:
    """The camera with a warning if an EXIF orientation is not applied: a K that was given may be
    for the upright image, unless its size or its principal point excludes that."""
    if image.orientation == 1 or camera.focal_source != "given" or _is_as_stored(camera, image):
        return camera
    warning = (
        f"EXIF orientation {image.orientation} is not applied: K must refer to the pixels as stored"
    )
    return replace(camera, warnings=(*camera.warnings, warning))


def _is_as_stored(camera: Camera, image: Image | Header) -> bool:
    """Whether K is certainly of the pixels as stored, and not of the image rotated by a quarter."""
    if image.orientation not in _QUARTER_TURNS:
        return False
    if camera.size is not None and camera.size[0] != camera.size[1]:
        return camera.size == image.size
    offsets = [
        float(np.abs((camera.K[:2, 2] + 0.5) / size - 0.5).max())
        for size in (image.size, image.size[::-1])
    ]
    return offsets[0] < _MAX_CENTRE_OFFSET < offsets[1]
