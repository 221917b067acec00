"""The camera of a photograph by its EXIF block."""

import math
import warnings
from dataclasses import dataclass
from typing import Any

import PIL.Image

MAKE, MODEL, EXIF_DIRECTORY = 271, 272, 34665
FOCAL_LENGTH, _WIDTH, _HEIGHT = 37386, 40962, 40963
_FOCAL_PLANE_X, _FOCAL_PLANE_Y, _FOCAL_PLANE_UNIT = 41486, 41487, 41488
_DIGITAL_ZOOM, _FOCAL_LENGTH_35MM, _LENS_MODEL = 41988, 41989, 42036
# The tags that `read_exif` reads in the directory of EXIF, beside the two in the block's first.
CAMERA_TAGS = (
    *(FOCAL_LENGTH, _WIDTH, _HEIGHT, _FOCAL_PLANE_X, _FOCAL_PLANE_Y, _FOCAL_PLANE_UNIT),
    *(_DIGITAL_ZOOM, _FOCAL_LENGTH_35MM, _LENS_MODEL),
)
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
    if not block:
        return Exif()
    try:
        with warnings.catch_warnings():
            warnings.simplefilter("ignore")  # about damaged directories
            exif = PIL.Image.Exif()
            exif.load(block)
            tags = exif.get_ifd(EXIF_DIRECTORY)
            read = {tag: tags.get(tag) for tag in CAMERA_TAGS}
            make, model = exif.get(MAKE), exif.get(MODEL)
    except Exception:  # a damaged block raises almost anything
        return Exif()
    zoom = _number(read[_DIGITAL_ZOOM])
    return Exif(
        _text(make),
        _text(model),
        _text(read[_LENS_MODEL]),
        _number(read[FOCAL_LENGTH]),
        _number(read[_FOCAL_LENGTH_35MM]),
        zoom if zoom is not None and 1 <= zoom <= _MAX_ZOOM else 1.0,
        _size(read[_WIDTH], read[_HEIGHT]),
        _pixels_per_mm(*(read[tag] for tag in (_FOCAL_PLANE_X, _FOCAL_PLANE_Y, _FOCAL_PLANE_UNIT))),
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
    sides = _number(width), _number(height)
    if sides[0] is None or sides[1] is None or not all(1 <= side < 2**31 for side in sides):  # type: ignore[operator]
        return None
    return int(sides[0]), int(sides[1])


def _pixels_per_mm(along_x: Any, along_y: Any, unit: Any) -> float | None:
    """None for pixels that are not square, as of sensors that were interpolated along one axis."""
    x, y = _number(along_x), _number(along_y)
    if x is None or (y is not None and abs(x - y) > _MAX_RESOLUTION_DIFFERENCE * x):
        return None
    unit_mm = _UNIT_MM.get(2 if unit is None else unit)
    return None if unit_mm is None else x / unit_mm
