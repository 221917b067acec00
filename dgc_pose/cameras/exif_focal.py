"""The focal length of an image from its EXIF data: of the lens, on 35 mm film, and the sensor."""

from __future__ import annotations

import math
from collections.abc import Iterator
from functools import lru_cache
from typing import NamedTuple

import PIL.Image
from PIL.ExifTags import IFD, Base
from PIL.TiffImagePlugin import IFDRational

from dgc_pose.images.decoding import Exif
from dgc_pose.system.files import scratch_folder

_FILM_DIAGONAL_MM = 43.27  # 36 mm x 24 mm
_BLANK_WIDTH = 1000  # of the image that COLMAP reads, pixels

# Standard deviations of ln(f in pixels). EXIF does not define which side of the image the focal
# length on 35 mm film refers to. Makers agreed on the diagonal (CIPA DCG-001); by the width, f
# would be 4 % less at 4:3. The correction of distortion and shake crops a few per cent too. A phone
# of 2011 has 5 to 14 % less, a Kodak 1 to 4 % more.
_FILM_FOCAL_STD = 0.08
_ROUNDING_STD_MM = 0.29  # of a number rounded to an integer
# The lens and the resolution of the sensor are nominal; the focus changes the focal length.
_SENSOR_RESOLUTION_STD = 0.06
# As above; and the table may have the width of another part of the sensor.
_SENSOR_TABLE_STD = 0.08
# Added for a digital zoom, which some phones write for only one of two steps, and for a crop.
_ZOOM_STD = 0.1
_CUT_STD = 0.05

_PLAUSIBLE_FOCALS = (0.2, 20.0)  # over the longer side: fields of view of 136 to 3 degrees
_SENSOR_RANGE_MM = (1.5, 80.0)  # widths and diagonals
_MAX_WIDTH_DIFFERENCE = 0.1  # between the logarithms of two widths of one sensor
# Sensors are 5:4 to 3:2; most images of another shape are crops of a 4:3 image.
_SENSOR_ASPECT_RANGE = (1.24, 1.52)
_USUAL_ASPECT = 4 / 3


class _Whole(NamedTuple):
    """Size of the image that the camera wrote, at the scale of the image, which may be a crop."""

    width: float
    height: float
    scale: float = 1.0  # pixels of the image per pixel that the camera wrote
    std: float = 0.0  # of the logarithm of the scale


def exif_focal(exif: Exif, size: tuple[float, float]) -> tuple[float, float, float] | None:
    """The EXIF focal length of an image of `size` (width, height), pixels; the standard deviation
    of its logarithm; and by how many pixels the image that the camera wrote is larger. None if EXIF
    has no plausible focal length."""
    if (whole := _whole(exif, size)) is None:
        return None
    for focal, std in _exif_focals(exif, whole):
        if _PLAUSIBLE_FOCALS[0] <= focal / max(size) <= _PLAUSIBLE_FOCALS[1]:
            margin = max(whole.width - size[0], whole.height - size[1])
            return focal, math.hypot(std, whole.std), margin
    return None


def _whole(exif: Exif, size: tuple[float, float]) -> _Whole | None:
    """The image that the camera wrote, from its size in EXIF data; None if the image is neither a
    scaled copy nor a crop of it.

    The scale of a crop lies between 1 and the smallest possible scale: the geometric mean is used.
    """
    if exif.size is None:
        return _Whole(*size)
    width, height = size
    sides = exif.size
    scale = max(size) / max(sides)
    if abs(scale * min(sides) - min(size)) <= 1 + 0.005 * min(size):
        return _Whole(width, height, scale)
    for whole in (sides, sides[::-1]):  # a rotated image may have the sides of the other
        least = max(width / whole[0], height / whole[1])
        if least <= 1:
            scale = math.sqrt(least)
            std = math.hypot(_CUT_STD, math.log(least) / 2)
            return _Whole(whole[0] * scale, whole[1] * scale, scale, std)
    return None


def _exif_focals(exif: Exif, whole: _Whole) -> Iterator[tuple[float, float]]:
    """Yield (focal length, deviation): from the focal length on film; from that of the lens with
    the sensor's resolution, then with its width in COLMAP's table. A resolution that the table
    contradicts is skipped: editors that shrink an image keep the old resolution."""
    film = exif.focal_35mm
    lens = exif.focal_mm
    zoom = exif.digital_zoom
    zoom_std = _ZOOM_STD if zoom > 1 else 0.0
    longer = max(whole.width, whole.height)
    shorter = min(whole.width, whole.height)
    sensor = 0.0 if lens is None or film is None else _FILM_DIAGONAL_MM * lens / film
    if film is not None and (lens is None or _is_sensor(sensor) or _is_sensor(sensor * zoom)):
        # No sensor has this shape: take the mean of this diagonal and that of a 4:3 image
        diagonal = math.hypot(longer, shorter)
        shape_std = 0.0
        if not _SENSOR_ASPECT_RANGE[0] <= longer / shorter <= _SENSOR_ASPECT_RANGE[1]:
            whole_diagonal = max(longer, _USUAL_ASPECT * shorter) * math.hypot(1, 1 / _USUAL_ASPECT)
            shape_std = math.log(whole_diagonal / diagonal) / 2
            diagonal = math.sqrt(diagonal * whole_diagonal)
        # Some makers include the zoom in the focal length on film; EXIF does not define it.
        std = math.hypot(
            *(_FILM_FOCAL_STD, _ROUNDING_STD_MM / film, shape_std, zoom_std, math.log(zoom) / 2)
        )
        yield math.sqrt(zoom) * film / _FILM_DIAGONAL_MM * diagonal, std
    if lens is None:
        return
    in_table = _sensor_width_mm(exif.make, exif.model)
    if exif.pixels_per_mm is not None:
        width = longer / whole.scale / exif.pixels_per_mm
        same = in_table is None or abs(math.log(width / in_table)) <= _MAX_WIDTH_DIFFERENCE
        if _is_sensor(width) and same:
            yield lens * zoom / width * longer, math.hypot(_SENSOR_RESOLUTION_STD, zoom_std)
    if in_table is not None:
        yield lens * zoom / in_table * longer, math.hypot(_SENSOR_TABLE_STD, zoom_std)


@lru_cache(maxsize=256)
def _sensor_width_mm(make: str, model: str) -> float | None:
    """The longer side of a camera's sensor, mm, from COLMAP's table; None if it is not there."""
    if not (make and model):
        return None
    from dgc_pose.system.colmap_library import pycolmap

    # COLMAP's table is not accessible: have COLMAP compute the focal length of an image file.
    exif = PIL.Image.Exif()
    exif[Base.Make] = make
    exif[Base.Model] = model
    exif.get_ifd(IFD.Exif)[Base.FocalLength] = IFDRational(1, 1)
    with scratch_folder() as folder:
        path = folder / "blank.jpg"
        PIL.Image.new("L", (_BLANK_WIDTH, 8)).save(path, exif=exif)
        camera = pycolmap.infer_camera_from_image(path)
    return _BLANK_WIDTH / camera.focal_length if camera.has_prior_focal_length else None


def _is_sensor(mm: float) -> bool:
    return _SENSOR_RANGE_MM[0] <= mm <= _SENSOR_RANGE_MM[1]
