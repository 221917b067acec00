"""The camera of an image without a K: a focal length with its deviation, from what the image says.

The principal point is the middle of the image.
"""

from dataclasses import replace
from typing import Literal, Protocol

import numpy as np

from dgc_pose.cameras.camera import Camera

Sharing = Literal["files", "shared", "two"]
SIZE_FOCAL = 1.1  # geometric middle of the focal lengths of photographs, over the longer side
SIZE_STD = 0.4  # deviation of their logarithm
CENTRE_STD = 0.01  # of the principal point from the middle, over the longer side


class Photograph(Protocol):
    """What an `Image` and the `Header` of a file say of the camera."""

    @property
    def size(self) -> tuple[int, int]:
        """(width, height) in pixels."""

    @property
    def exif(self) -> bytes:
        """The EXIF block, empty without one."""

    @property
    def orientation(self) -> int:
        """By EXIF, 1 to 8, which is not applied; 1 is upright."""


def auto_camera(image: Photograph) -> Camera:
    """The camera of an image without a K.

    `identity` is equal for images that one camera may have taken: of the same size, and of the same
    camera and focal length by their EXIF data.
    """
    width, height = image.size
    focal = SIZE_FOCAL * max(width, height)
    K = np.array([[focal, 0, (width - 1) / 2], [0, focal, (height - 1) / 2], [0, 0, 1]])
    return Camera(
        K,
        image.size,
        focal_std=SIZE_STD,
        centre_std=CENTRE_STD * max(width, height),
        focal_source="size",
        identity=f"auto {max(width, height)} x {min(width, height)}",
    )


def auto_cameras(
    image1: Photograph, image2: Photograph, sharing: Sharing = "files"
) -> tuple[Camera, Camera]:
    """`auto_camera` of two images.

    sharing: whether one camera took both: "files" decides by the `identity` of both.
    """
    camera1, camera2 = auto_camera(image1), auto_camera(image2)
    if sharing == "files":
        return camera1, camera2
    identities = ("shared", "shared") if sharing == "shared" else ("image1", "image2")
    return replace(camera1, identity=identities[0]), replace(camera2, identity=identities[1])


def with_orientation(camera: Camera, image: Photograph) -> Camera:
    """The camera with a warning if an EXIF orientation is not applied: a K that was given may be
    for the upright image."""
    if image.orientation == 1 or camera.focal_source != "given":
        return camera
    warning = (
        f"EXIF orientation {image.orientation} is not applied: K must refer to the pixels as stored"
    )
    return replace(camera, warnings=(*camera.warnings, warning))
