"""Whether a K can be that of an image: by its size and its principal point."""

from dataclasses import replace

import numpy as np
from numpy.typing import ArrayLike

from dgc_pose.cameras.camera import Camera
from dgc_pose.errors import InputError
from dgc_pose.geometry.pixels import Size

_MAX_USUAL_OFFSET = 0.2  # of the principal point from the middle, as a share of the image's side
_MAX_ASPECT_DIFFERENCE = 0.03  # of the logarithms of two aspect ratios that are the same
# Logarithms of the scale between two sizes of the same aspect ratio: less is the same size, and
# more cannot be the image's.
_MAX_SAME_SCALE, _MAX_POSSIBLE_SCALE = 0.1, 0.4


def checked_camera(camera: Camera, size: Size, name: str, image: str = "the image") -> Camera:
    """The camera of an image of `size` (width, height), called `image`, with warnings.

    Raises InputError, naming the argument `name`, if the camera's size differs; or if its principal
    point lies outside the image, or, of a camera without a size, in the middle of the image turned
    by 90 degrees or of one of far more or fewer pixels. Warns if the principal point is that of an
    image of another size, or is far from the middle.
    """
    if camera.size is not None and camera.size != size:
        turned = ": K is of the image turned by 90 degrees" if camera.size == size[::-1] else ""
        raise InputError(
            f"{name} is for an image of {camera.size[0]} x {camera.size[1]} pixels, {image} has "
            f"{size[0]} x {size[1]}{turned}"
        )
    centre = camera.K[:2, 2]
    place = f"{name} has its principal point at ({centre[0]:g}, {centre[1]:g})"
    if camera.size is None and (centre > 0).all():
        of_K = 2 * centre + 1  # the size of an image whose middle the principal point is
        x, y = np.log(of_K / size)
        turned_x, turned_y = np.log(of_K / size[::-1])
        is_scaled = abs(x - y) <= _MAX_ASPECT_DIFFERENCE
        is_turned = abs(turned_x - turned_y) <= _MAX_ASPECT_DIFFERENCE
        is_turned = is_turned and abs(np.log(size[0] / size[1])) > _MAX_SAME_SCALE
        scale = abs(np.log(of_K.max() / max(size)))
        if is_turned or (is_scaled and scale > _MAX_SAME_SCALE):
            problem = (
                f"{place}, the middle of an image of about {times(np.rint(of_K).astype(int))}, and "
                f"{image} has {times(size)}"
            )
            if is_turned:
                raise InputError(f"{problem}: K is of the image turned by 90 degrees")
            if scale > _MAX_POSSIBLE_SCALE:
                raise InputError(problem)
            return replace(camera, warnings=(*camera.warnings, problem))
    shares = (centre + 0.5) / size
    if shares.min() <= 0 or shares.max() >= 1:
        raise InputError(f"{place}, outside {image} of {times(size)}")
    if np.abs(shares - 0.5).max() <= _MAX_USUAL_OFFSET:
        return camera
    warning = f"{place}, far from the middle of {image} of {times(size)}"
    return replace(camera, warnings=(*camera.warnings, warning))


def times(size: ArrayLike) -> str:
    """A size as 640x480."""
    width, height = np.asarray(size).tolist()
    return f"{width}x{height}"
