"""Whether a K can be that of an image: by its size, its principal point and its field of view."""

import math
from dataclasses import replace

from dgc_pose.cameras.camera import Camera
from dgc_pose.errors import InputError

MAX_FIELD_OF_VIEW_DEG, MIN_FIELD_OF_VIEW_DEG = 150.0, 1.0  # horizontal, of a pinhole
_MAX_USUAL_OFFSET = 0.2  # of the principal point from the middle, as a share of the image's side
_MAX_ASPECT_DIFFERENCE = 0.03  # of the logarithms of two aspect ratios that are the same
# Logarithms of the scale between two sizes of the same aspect ratio: less is the same size, and
# more cannot be the image's.
_MAX_SAME_SCALE, _MAX_POSSIBLE_SCALE = 0.1, 0.4
_WIDER_THAN_PINHOLE = ("FISHEYE", "FOV", "EUCM", "DIVISION")

Size = tuple[int, int]  # (width, height), pixels


def checked_camera(camera: Camera, size: Size, name: str) -> Camera:
    """The camera with the warnings of `check_size`, which raises InputError."""
    return replace(camera, warnings=camera.warnings + check_size(camera, size, name))


def check_size(camera: Camera, size: Size, name: str) -> tuple[str, ...]:
    """Check that a camera belongs to an image of `size` (width, height).

    Raises InputError, naming the argument `name`, if the camera's size differs; if its principal
    point lies outside the image, or, of a camera without a size, in the middle of one of far more
    or fewer pixels; or if a pinhole's field of view is above `MAX_FIELD_OF_VIEW_DEG`. Returns a
    warning if the principal point is that of an image of another size or turned by 90 degrees, or
    is far from the middle; and if the field of view is below `MIN_FIELD_OF_VIEW_DEG`.
    """
    if camera.size is not None and camera.size != size:
        raise InputError(f"{name} {_other_size(camera.size, size, name)}")
    x, y = float(camera.K[0, 2]), float(camera.K[1, 2])
    is_inside = -0.5 < x < size[0] - 0.5 and -0.5 < y < size[1] - 0.5
    text = f"{name} has its principal point at ({x:g}, {y:g})"
    other = _size_by_centre(x, y, size) if camera.size is None else None
    is_far_off = other is not None and not _alike(max(other), max(size), _MAX_POSSIBLE_SCALE)
    if other is not None:
        middle = f"{text}, the middle of an image of about {_times(other)}, and"
        text = f"{middle} {_turned_or_scaled(other, size, name)}"
    elif not is_inside:
        text = f"{text}, outside the image of {_times(size)}"
    elif _offset(x, y, size) > _MAX_USUAL_OFFSET:
        text = f"{text}, far from the middle of the image of {_times(size)}"
    else:
        text = ""
    angle = _field_of_view_deg(camera, size[0])
    is_too_wide = angle is not None and angle > MAX_FIELD_OF_VIEW_DEG
    if text and (not is_inside or is_far_off or (is_too_wide and other is not None)):
        raise InputError(text)
    warnings = [text] if text else []
    if angle is not None and not MIN_FIELD_OF_VIEW_DEG <= angle <= MAX_FIELD_OF_VIEW_DEG:
        warnings.append(
            f"{name} has a focal length of {camera.K[0, 0]:g} pixels, which is a field of view of "
            f"{angle:.3g} degrees in the image of {_times(size)}; K is in pixels of the image"
        )
        if is_too_wide:
            raise InputError(warnings[-1])
    return tuple(warnings)


def _field_of_view_deg(camera: Camera, width: int) -> float | None:
    """Horizontal; None for a lens that sees more than a pinhole of its focal length."""
    if camera.distortion is not None and any(
        word in camera.distortion.model for word in _WIDER_THAN_PINHOLE
    ):
        return None
    return math.degrees(2 * math.atan(width / 2 / float(camera.K[0, 0])))


def _size_by_centre(x: float, y: float, size: Size) -> Size | None:
    """The size whose middle the principal point is, if that is the image's scaled or turned, and
    not the image's."""
    if not (x > 0 and y > 0):
        return None
    scale = (2 * x + 1) / size[0], (2 * y + 1) / size[1]
    is_scaled = _alike(*scale, _MAX_ASPECT_DIFFERENCE) and not _alike(
        max(scale), 1, _MAX_SAME_SCALE
    )
    turned = (2 * x + 1) / size[1], (2 * y + 1) / size[0]
    is_turned = _alike(*turned, _MAX_ASPECT_DIFFERENCE) and not _alike(
        size[0], size[1], _MAX_SAME_SCALE
    )
    return (round(2 * x + 1), round(2 * y + 1)) if is_scaled or is_turned else None


def _other_size(of_K: Size, size: Size, name: str) -> str:
    text = f"is for an image of {of_K[0]} x {of_K[1]} pixels, the image has {size[0]} x {size[1]}"
    if _alike(of_K[0] * size[1], of_K[1] * size[0], _MAX_ASPECT_DIFFERENCE):
        return text + _scaling(of_K, name)
    return f"{text}: it is of the image turned by 90 degrees" if of_K[::-1] == size else text


def _turned_or_scaled(of_K: Size, size: Size, name: str) -> str:
    if _alike(of_K[0] * size[1], of_K[1] * size[0], 2 * _MAX_ASPECT_DIFFERENCE):
        return f"the image has {_times(size)}" + _scaling(of_K, name)
    return f"the image has {_times(size)}: K is of the image turned by 90 degrees"


def _scaling(of_K: Size, name: str) -> str:
    """What to do, where the camera is that of an option."""
    return f": --K-size {_times(of_K)} scales it" if name.startswith("--") else ""


def _alike(first: float, second: float, tolerance: float) -> bool:
    return abs(math.log(first / second)) <= tolerance


def _offset(x: float, y: float, size: Size) -> float:
    """Of the principal point from the middle, as a share of the side."""
    return max(abs((x + 0.5) / size[0] - 0.5), abs((y + 0.5) / size[1] - 0.5))


def _times(size: Size) -> str:
    return f"{size[0]}x{size[1]}"
