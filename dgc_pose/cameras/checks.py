"""Whether a K can be that of an image: by its size, its principal point and its field of view."""

import math
from dataclasses import replace
from typing import Literal

from dgc_pose.cameras.camera import Camera
from dgc_pose.errors import InputError
from dgc_pose.geometry.pixels import Size

MAX_FIELD_OF_VIEW_DEG, MIN_FIELD_OF_VIEW_DEG = 150.0, 1.0  # horizontal, of a pinhole
_MAX_USUAL_OFFSET = 0.2  # of the principal point from the middle, as a share of the image's side
_MAX_ASPECT_DIFFERENCE = 0.03  # of the logarithms of two aspect ratios that are the same
# Logarithms of the scale between two sizes of the same aspect ratio: less is the same size, and
# more cannot be the image's.
_MAX_SAME_SCALE, _MAX_POSSIBLE_SCALE = 0.1, 0.4
_WIDER_THAN_PINHOLE = ("FISHEYE", "FOV", "EUCM", "DIVISION")
_FACTORS = (1 / 4, 1 / 3, 1 / 2, 2 / 3, 3 / 2, 2, 3, 4)  # by which images are usually resized
_MAX_SIZE_DIFFERENCE = 0.03  # of the logarithms of a side that K may be for and that of its middle


def checked_camera(
    camera: Camera, size: Size, name: str, image: str = "the image", other: Size | None = None
) -> Camera:
    """The camera of an image of `size` (width, height), called `image`, with warnings; `other` is
    the size of another image that K may be for.

    Raises InputError, naming the argument `name`, if the camera's size differs; if its principal
    point lies outside the image, or, of a camera without a size, in the middle of the image turned
    by 90 degrees or of one of far more or fewer pixels; or if a pinhole's field of view is above
    `MAX_FIELD_OF_VIEW_DEG`. Warns if the principal point is that of an image of another size, or is
    far from the middle; and if the field of view is below `MIN_FIELD_OF_VIEW_DEG`.
    """
    if camera.size is not None and camera.size != size:
        raise InputError(
            f"{name} is for an image of {camera.size[0]} x {camera.size[1]} pixels, {image} has "
            f"{size[0]} x {size[1]}{_hint(camera.size, size, name, camera.size)}"
        )
    x, y = float(camera.K[0, 2]), float(camera.K[1, 2])
    is_possible = -0.5 < x < size[0] - 0.5 and -0.5 < y < size[1] - 0.5
    centre = f"{name} has its principal point at ({x:g}, {y:g})"
    of_K = round(2 * x + 1), round(2 * y + 1)  # whose middle the principal point is
    warnings = []
    if camera.size is None and min(of_K) > 1 and _relation(of_K, size) in ("scaled", "turned"):
        warnings.append(
            f"{centre}, the middle of an image of about {times(of_K)}, and {image} has "
            f"{times(size)}{_hint(of_K, size, name, other)}"
        )
        is_near = _alike(max(of_K), max(size), _MAX_POSSIBLE_SCALE)
        is_possible = is_possible and is_near and _relation(of_K, size) == "scaled"
    elif not is_possible:
        warnings.append(f"{centre}, outside {image} of {times(size)}")
    elif max(abs((x + 0.5) / size[0] - 0.5), abs((y + 0.5) / size[1] - 0.5)) > _MAX_USUAL_OFFSET:
        warnings.append(f"{centre}, far from the middle of {image} of {times(size)}")
    if not is_possible:
        raise InputError(warnings[0])
    angle = math.degrees(2 * math.atan(size[0] / 2 / float(camera.K[0, 0])))
    model = "" if camera.distortion is None else camera.distortion.model
    sees_more = any(word in model for word in _WIDER_THAN_PINHOLE)
    if not (sees_more or MIN_FIELD_OF_VIEW_DEG <= angle <= MAX_FIELD_OF_VIEW_DEG):
        warnings.append(
            f"{name} has a focal length of {camera.K[0, 0]:g} pixels, which is a field of view of "
            f"{angle:.3g} degrees in {image} of {times(size)}; K is in pixels of the image"
        )
        if angle > MAX_FIELD_OF_VIEW_DEG:
            raise InputError(warnings[-1])
    return replace(camera, warnings=(*camera.warnings, *warnings))


def _relation(of_K: Size, size: Size) -> Literal["same", "scaled", "turned", "other"]:
    """How the size that K is for and that of the image are alike."""
    if _alike(of_K[0] * size[1], of_K[1] * size[0], _MAX_ASPECT_DIFFERENCE):
        return "same" if _alike(max(of_K), max(size), _MAX_SAME_SCALE) else "scaled"
    is_turned = _alike(of_K[0] * size[0], of_K[1] * size[1], _MAX_ASPECT_DIFFERENCE)
    return "turned" if is_turned and not _alike(*size, _MAX_SAME_SCALE) else "other"


def _hint(of_K: Size, size: Size, name: str, other: Size | None) -> str:
    """The option that scales K, where it is that of an option, with the size of the other image or
    this one's by a usual factor: a principal point does not tell it. Or that K is turned."""
    relation = _relation(of_K, size)
    if relation in ("same", "scaled") and name.startswith("--"):
        scaled = [(round(size[0] * factor), round(size[1] * factor)) for factor in _FACTORS]
        for known in [*([other] if other else []), *scaled]:
            if all(_alike(known[axis], of_K[axis], _MAX_SIZE_DIFFERENCE) for axis in (0, 1)):
                return f": --K-size {times(known)} scales it"
    return ": K is of the image turned by 90 degrees" if relation == "turned" else ""


def _alike(first: float, second: float, tolerance: float) -> bool:
    return abs(math.log(first / second)) <= tolerance


def times(size: Size) -> str:
    return f"{size[0]}x{size[1]}"
