"""The camera of a photograph by its EXIF block."""

import math
from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any

import PIL.Image

MAKE, MODEL, EXIF_DIRECTORY = 271, 272, 34665
FOCAL_LENGTH, _WIDTH, _HEIGHT = 37386, 40962, 40963
_FOCAL_PLANE_X, _FOCAL_PLANE_Y, _FOCAL_PLANE_UNIT = 41486, 41487, 41488
_DIGITAL_ZOOM, _FOCAL_LENGTH_35MM, _LENS_MODEL = 41988, 41989, 42036
_UNIT_MM = {2: 25.4, 3: 10.0, 4: 1.0, 5: 0.001}  # of resolutions; 2 where a file has none
_MAX_ZOOM = 200.0
_MAX_RESOLUTION_DIFFERENCE = 0.02  # of square pixels, along x and y, as a share
_MAX_TEXT = 80  # characters of a name


@dataclass(frozen=True)
class Exif:
    """A camera by EXIF data. Numbers are positive and finite, None where there is none."""

    make: str = ""
    model: str = ""
    lens: str = ""
    focal_mm: float | None = None  # of the lens
    # Of a lens with the same field of view on 35 mm film, whose frame is 36 mm x 24 mm
    focal_35mm: float | None = None
    digital_zoom: float = 1.0  # at least 1
    size: tuple[int, int] | None = None  # (width, height) of the image that the camera wrote
    pixels_per_mm: float | None = None  # of that image, on the sensor


def read_exif(block: bytes) -> Exif:
    """Read an EXIF block, with or without `Exif\\0\\0` before it; a damaged one as an empty one."""
    try:
        exif = PIL.Image.Exif()
        exif.load(block)
        return camera_tags(exif, exif.get_ifd(EXIF_DIRECTORY))
    except Exception:  # a damaged block raises almost anything
        return Exif()


def camera_tags(first: Mapping[int, Any], more: Mapping[int, Any]) -> Exif:
    """The camera by the tags of the first directory and of that of EXIF.

    Raises any exception for a tag that is damaged.
    """
    zoom = _number(more.get(_DIGITAL_ZOOM))
    plane = (more.get(tag) for tag in (_FOCAL_PLANE_X, _FOCAL_PLANE_Y, _FOCAL_PLANE_UNIT))
    return Exif(
        _text(first.get(MAKE)),
        _text(first.get(MODEL)),
        _text(more.get(_LENS_MODEL)),
        _number(more.get(FOCAL_LENGTH)),
        _number(more.get(_FOCAL_LENGTH_35MM)),
        zoom if zoom is not None and 1 <= zoom <= _MAX_ZOOM else 1.0,
        _size(more.get(_WIDTH), more.get(_HEIGHT)),
        _pixels_per_mm(*plane),
    )


def _number(value: Any) -> float | None:
    """A positive number; 0 stands for one that is not known."""
    if isinstance(value, (str, bytes, tuple)):
        return None
    try:
        number = float(value)
    except (TypeError, ValueError, ArithmeticError):
        return None
    return number if math.isfinite(number) and number > 0 else None


def _text(value: Any) -> str:
    """A name in one line, without what some cameras fill it up with."""
    if not isinstance(value, str):
        return ""
    return " ".join("".join(c if c.isprintable() else " " for c in value).split())[:_MAX_TEXT]


def _size(width: Any, height: Any) -> tuple[int, int] | None:
    sides = [int(side) for side in map(_number, (width, height)) if side and 1 <= side < 2**31]
    return (sides[0], sides[1]) if len(sides) == 2 else None


def _pixels_per_mm(along_x: Any, along_y: Any, unit: Any) -> float | None:
    """None for pixels that are not square, as of sensors that were interpolated along one axis."""
    x, y = _number(along_x), _number(along_y)
    if x is None or (y is not None and abs(x - y) > _MAX_RESOLUTION_DIFFERENCE * x):
        return None
    unit_mm = _UNIT_MM.get(2 if unit is None else unit)
    return None if unit_mm is None else x / unit_mm
