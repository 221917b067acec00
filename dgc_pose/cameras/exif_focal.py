"""The focal length in pixels by the EXIF data of an image file, with its deviation."""

import math
from collections.abc import Iterator
from dataclasses import dataclass
from functools import lru_cache
from itertools import chain

import PIL.Image
from PIL.TiffImagePlugin import IFDRational

from dgc_pose.files.outputs import scratch_folder
from dgc_pose.images.exif import EXIF_DIRECTORY, FOCAL_LENGTH, MAKE, MODEL, Exif
from dgc_pose.system.stderr import quiet

_FILM_DIAGONAL_MM = 43.27  # of 36 mm x 24 mm
_BLANK_WIDTH = 1000  # of the image that COLMAP reads, pixels

# Deviations of the logarithm of the focal length in pixels. That on 35 mm film: EXIF leaves open
# which side of the images it holds for; cameras' makers agreed on the diagonal (CIPA DCG-001), and
# by the width it would be 4 % less at 4:3. Pixels that the correction of distortion and shake
# leaves out, and the focus, are a few per cent too.
FILM_FOCAL_STD = 0.06
ROUNDING_STD_MM = 0.29  # deviation of a number that is rounded to an integer
# The lens and the resolution of the sensor are nominal; the focus changes the focal length.
SENSOR_RESOLUTION_STD = 0.06
# As before; and the table's width may be of another part of the sensor than the image's.
SENSOR_TABLE_STD = 0.08
# More for a digital zoom, which some telephones write of one of two steps, and for an image that
# was cut out of another.
ZOOM_STD, CUT_STD = 0.1, 0.05

PLAUSIBLE_FOCALS = (0.2, 20.0)  # over the longer side: fields of view of 136 to 3 degrees
_SENSOR_RANGE_MM = (1.5, 80.0)  # widths and diagonals
_MAX_WIDTH_DIFFERENCE = 0.1  # of the logarithms of two widths of one sensor
# Whether the focal length on 35 mm film has the digital zoom in it, by the make, as in files of
# theirs. EXIF leaves it open, and others do either.
_ZOOM_IN_FILM = {"apple": True, "samsung": False}
# Sensors are 5:4 to 3:2; images of another shape are mostly parts of one of 4:3.
_SENSOR_ASPECT_RANGE, _USUAL_ASPECT = (1.24, 1.52), 4 / 3


@dataclass(frozen=True)
class ExifFocal:
    """A focal length by EXIF data."""

    focal: float | None = None  # pixels; None without one
    std: float = 0.0  # standard deviation of its logarithm
    centre_std: float = 0.0  # of the principal point, if the image was cut out of another; pixels
    warnings: tuple[str, ...] = ()


@dataclass(frozen=True)
class _Whole:
    """The image that the camera wrote, of which there may be a part, at the part's scale."""

    width: float
    height: float
    scale: float = 1.0  # to this from the pixels that the camera wrote
    std: float = 0.0  # of the logarithm of the scale


def exif_focal(exif: Exif, size: tuple[int, int]) -> ExifFocal:
    """The focal length of an image of `size` (width, height) by its EXIF data.

    That on 35 mm film comes first; then that of the lens, with the resolution on the sensor or the
    sensor's width in COLMAP's table. One that contradicts the others, or that is no photograph's,
    is not believed, with a warning if there is no other.
    """
    whole = _whole(exif, size)
    if whole is not None:
        margin = max(whole.width - size[0], whole.height - size[1])
        for focal, std in chain(_on_film(exif, whole), _on_sensor(exif, whole)):
            if PLAUSIBLE_FOCALS[0] <= focal / max(size) <= PLAUSIBLE_FOCALS[1]:
                warnings = (_cut(exif, size),) if margin else ()
                std = math.hypot(std, whole.std)
                return ExifFocal(focal, std, margin / math.sqrt(12), warnings)
    if exif.focal_35mm is None and (exif.focal_mm is None or exif.pixels_per_mm is None):
        return ExifFocal()
    return ExifFocal(warnings=(_unbelieved(exif, size),))


def _whole(exif: Exif, size: tuple[int, int]) -> _Whole | None:
    """None if the image is neither the one that the camera wrote, at any scale, nor a part of it.

    A part is as large as it was, or as large as shows the most of the other image: the scale is the
    middle of both.
    """
    if exif.size is None:
        return _Whole(*size)
    (width, height), sides = size, exif.size
    scale = max(size) / max(sides)
    if abs(scale * min(sides) - min(size)) <= 1 + 0.005 * min(size):
        return _Whole(width, height, scale)
    for whole in (sides, sides[::-1]):  # a rotated image may have the sides of the other
        least = max(width / whole[0], height / whole[1])
        if least <= 1:
            scale = math.sqrt(least)
            std = math.hypot(CUT_STD, math.log(least) / 2)
            return _Whole(whole[0] * scale, whole[1] * scale, scale, std)
    return None


def _on_film(exif: Exif, whole: _Whole) -> Iterator[tuple[float, float]]:
    """The focal length and its deviation by that on 35 mm film."""
    film, zoom = exif.focal_35mm, exif.digital_zoom
    if film is None:
        return
    if exif.focal_mm is not None:
        sensor = _FILM_DIAGONAL_MM * exif.focal_mm / film
        if not (_is_sensor(sensor) or _is_sensor(sensor * zoom)):
            return
    diagonal, shape_std = _diagonal(whole)
    more, zoom_std = 1.0, 0.0
    if zoom > 1:
        inside = _ZOOM_IN_FILM.get(exif.make.lower())
        more = {True: 1.0, False: zoom, None: math.sqrt(zoom)}[inside]
        zoom_std = ZOOM_STD if inside is not None else math.hypot(ZOOM_STD, math.log(zoom) / 2)
    std = math.hypot(FILM_FOCAL_STD, ROUNDING_STD_MM / film, shape_std, zoom_std)
    yield more * film / _FILM_DIAGONAL_MM * diagonal, std


def _on_sensor(exif: Exif, whole: _Whole) -> Iterator[tuple[float, float]]:
    """The focal length and its deviation by that of the lens.

    Editors leave the resolution of an image that they made smaller: it is not believed against the
    table.
    """
    if exif.focal_mm is None:
        return
    longer = max(whole.width, whole.height)
    focal = exif.focal_mm * exif.digital_zoom
    zoom_std = ZOOM_STD if exif.digital_zoom > 1 else 0.0
    in_table = _sensor_width_mm(exif.make, exif.model)
    if exif.pixels_per_mm is not None:
        width = longer / whole.scale / exif.pixels_per_mm
        same = in_table is None or abs(math.log(width / in_table)) <= _MAX_WIDTH_DIFFERENCE
        if _is_sensor(width) and same:
            yield focal / width * longer, math.hypot(SENSOR_RESOLUTION_STD, zoom_std)
    if in_table is not None:
        yield focal / in_table * longer, math.hypot(SENSOR_TABLE_STD, zoom_std)


@lru_cache(maxsize=256)
def _sensor_width_mm(make: str, model: str) -> float | None:
    """The longer side of a camera's sensor, millimetres, in COLMAP's table; None if it has no such
    camera."""
    if not (make and model):
        return None
    from dgc_pose.system.colmap_library import pycolmap

    # The table itself is out of reach: COLMAP gives the focal length in pixels of an image file
    # whose lens has 1 mm. Of a photograph it would decode all pixels, prefer the focal length on
    # 35 mm film without its deviation, and not read HEIC.
    exif = PIL.Image.Exif()
    exif[MAKE], exif[MODEL] = make, model
    exif.get_ifd(EXIF_DIRECTORY)[FOCAL_LENGTH] = IFDRational(1, 1)
    with scratch_folder() as folder:
        path = folder / "blank.jpg"
        PIL.Image.new("L", (_BLANK_WIDTH, 8)).save(path, exif=exif)
        with quiet():
            camera = pycolmap.infer_camera_from_image(path)
    return _BLANK_WIDTH / camera.focal_length if camera.has_prior_focal_length else None


def _diagonal(whole: _Whole) -> tuple[float, float]:
    """The diagonal that stands for that of the film, and the deviation of its logarithm.

    Of an image of no sensor's shape: between its diagonal and that of the sensor's image.
    """
    longer, shorter = max(whole.width, whole.height), min(whole.width, whole.height)
    diagonal = math.hypot(longer, shorter)
    if _SENSOR_ASPECT_RANGE[0] <= longer / shorter <= _SENSOR_ASPECT_RANGE[1]:
        return diagonal, 0.0
    sensor = max(longer, _USUAL_ASPECT * shorter) * math.hypot(1, 1 / _USUAL_ASPECT)
    return math.sqrt(diagonal * sensor), math.log(sensor / diagonal) / 2


def _is_sensor(mm: float) -> bool:
    return _SENSOR_RANGE_MM[0] <= mm <= _SENSOR_RANGE_MM[1]


def _cut(exif: Exif, size: tuple[int, int]) -> str:
    return (
        f"{_by(size)} pixels are a part of the {_by(exif.size)} that the EXIF data are of: "
        f"the focal length and the middle are less certain"
    )


def _unbelieved(exif: Exif, size: tuple[int, int]) -> str:
    words = {"on 35 mm film": exif.focal_35mm, "of the lens": exif.focal_mm}
    lengths = " and ".join(f"{mm:g} mm {of}" for of, mm in words.items() if mm is not None)
    whole = "" if exif.size is None else f", of an image of {_by(exif.size)},"
    return (
        f"the EXIF data say a focal length of {lengths}{whole} which is not believed of "
        f"{_by(size)} pixels: it is taken from the size"
    )


def _by(size: tuple[int, int] | None) -> str:
    return "?" if size is None else f"{size[0]} x {size[1]}"
