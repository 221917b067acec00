"""The header of an encoded image, without decoding a pixel: format, size, camera, pixels' shape.

A file has the format of its first bytes, whatever its name. Pillow reads the headers, OpenCV the
pixels; pillow-heif, where it is installed, reads HEIC. A decoder takes memory for what a header
claims, so an image is decoded only after its size is known.
"""

import io
import math
import re
import warnings
from collections.abc import Mapping
from dataclasses import dataclass, replace
from typing import Any

import PIL.Image

from dgc_pose.errors import is_installed
from dgc_pose.geometry.pixels import EXCHANGING, Size

START_BYTES = 4096  # of a file, which its format is recognised by
_RAW = "RAW"
# The formats by their first bytes, stricter than Pillow's tests; the names are Pillow's.
_FORMATS = {
    name: re.compile(start, re.DOTALL)
    for name, start in {
        "JPEG": rb"\xff\xd8\xff",
        "PNG": rb"\x89PNG\r\n\x1a\n",
        _RAW: rb"II\*\0....CR|.{4}ftypcrx |IIRO|IIRS|MMOR|IIU\0|FUJIFILMCCD-RAW",
        "TIFF": rb"II[*+]\0|MM\0[*+]",
        "WEBP": rb"RIFF....WEBP",
        "BMP": rb"BM.{12}[\x0c\x10\x28\x34\x38\x40\x6c\x7c]\0\0\0",
        "PPM": rb"P[1-6](\s*#|\s+\d)",
        "GIF": rb"GIF8[79]a",
        "JPEG2000": rb"\xff\x4f\xff\x51|\0\0\0\x0cjP  \r\n\x87\n",
        "AVIF": rb".{4}ftyp(avi[fs]|mi[af][f1].{4,40}avif)",
        "HEIF": rb".{4}ftyp(hei[cxms]|hev[cxms]|mif1|msf1)",
    }.items()
}
_KIND, _WIDTH, _HEIGHT, _ORIENTATION, _DNG_VERSION = 254, 256, 257, 274, 50706  # tags of TIFF
_SAMPLES, _X_RESOLUTION, _Y_RESOLUTION = 277, 282, 283
MAKE, MODEL, EXIF_DIRECTORY, _GPS_DIRECTORY = 271, 272, 34665, 34853
FOCAL_LENGTH, _EXIF_WIDTH, _EXIF_HEIGHT = 37386, 40962, 40963
_FOCAL_PLANE_X, _FOCAL_PLANE_Y, _FOCAL_PLANE_UNIT = 41486, 41487, 41488
_DIGITAL_ZOOM, _FOCAL_LENGTH_35MM, _LENS_MODEL = 41988, 41989, 42036
_UNIT_MM = {2: 25.4, 3: 10.0, 4: 1.0, 5: 0.001}  # of resolutions; 2 where a file has none
_MAX_ZOOM = 200.0
_MAX_RESOLUTION_DIFFERENCE = 0.02  # of square pixels, along x and y, as a share
_MAX_TEXT = 80  # characters of a name
_PIXEL_ASPECTS = (0.25, 4.0)  # plausible ones
# Of Google's XMP of panoramas, as an attribute or an element.
_PROJECTION = re.compile(rb"GPano:ProjectionType[\s=\"'>]+((?i:equirectangular|cylindrical))")


class UnreadableFormatError(ValueError):
    """A file's format is not known, or is not read. The message names what the file is."""


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
    position: tuple[float, float, float] | None = None  # latitude, longitude, degrees; altitude, m
    orientation: int = 1  # 1 to 8, of the pixels as stored, which a loaded image has had applied


@dataclass(frozen=True)
class Header:
    """What the header of an encoded image says of the upright image."""

    format: str  # a key of `_FORMATS`
    size: Size  # (width, height)
    exif: Exif = Exif()
    pixel_aspect: float = 1.0  # width of a pixel over its height; 1 if not stated
    projection: str = ""  # "equirectangular" or "cylindrical", of a panorama by XMP; else ""


def image_format(start: bytes) -> str:
    """The format of an image file by its first `START_BYTES` or more, or by all of a smaller file.

    Raises UnreadableFormatError, which names what the file is, if it is not read.
    """
    name = next((name for name, pattern in _FORMATS.items() if pattern.match(start)), None)
    if name is None:
        raise UnreadableFormatError("not an image of a known format")
    if name == _RAW or (name == "TIFF" and _is_raw(start)):
        raise UnreadableFormatError(
            "a camera's raw file, or begins with a thumbnail, and neither is read"
        )
    if name == "HEIF" and not is_installed("pillow_heif"):
        raise UnreadableFormatError("HEIC, which needs pillow-heif: pip install '.[heic]'")
    return name


def read_header(data: bytes, *, complete: bool = True) -> Header:
    """The header of an encoded image.

    complete: whether `data` is all of the file, and not its beginning, of a PNG its end too; then
    the checksums of a PNG are checked.

    Raises UnreadableFormatError if the format is not read, any other exception if the header is
    damaged.
    """
    name, found = image_format(data), _PROJECTION.search(data)
    projection = found[1].decode().lower() if found else ""
    with warnings.catch_warnings():
        warnings.simplefilter("ignore")  # about EXIF blocks and huge images
        if name == "HEIF":
            return replace(_heif_header(data), projection=projection)
        if name == "TIFF":
            tags = _tiff_tags(data)
            if (samples := tags.get(_SAMPLES, 1)) > 4:  # OpenCV decodes no more
                raise UnreadableFormatError(f"a TIFF of {samples} samples a pixel, not 1, 3 or 4")
            if not complete and {EXIF_DIRECTORY, _GPS_DIRECTORY, MAKE, MODEL}.intersection(tags):
                raise ValueError("the EXIF data may lie behind the start")
            return _upright(
                name, (int(tags[_WIDTH]), int(tags[_HEIGHT])), *read_exif(data), projection
            )
        return replace(_pillow_header(data, name, complete), projection=projection)


def _is_raw(start: bytes) -> bool:
    """Whether the first image of a TIFF is a thumbnail or a sensor's mosaic, as raw files have.

    False if the tags lie behind the start.
    """
    try:
        with warnings.catch_warnings():
            warnings.simplefilter("ignore")
            tags = _tiff_tags(start)
        return _DNG_VERSION in tags or bool(tags.get(_KIND, 0) & 1)
    except Exception:  # damaged tags, which the header's reader refuses
        return False


def _tiff_tags(data: bytes, offset: int | None = None) -> Any:
    """The tags of a TIFF's first image, or of the directory at an offset. Pillow's reader
    of images refuses kinds that OpenCV decodes, such as floats in three colours."""
    from PIL.TiffImagePlugin import ImageFileDirectory_v2

    stream = io.BytesIO(data)
    directory = ImageFileDirectory_v2(stream.read(16 if b"+" in data[2:4] else 8))
    stream.seek(directory.next if offset is None else offset)
    directory.load(stream)
    return directory


def _pillow_header(data: bytes, name: str, complete: bool) -> Header:
    """Not by PIL.Image.open, which refuses 179 million pixels: telephones take such images."""
    PIL.Image.init()
    if name not in PIL.Image.OPEN:
        raise UnreadableFormatError(f"{name}, which this Pillow does not read")
    factory, _ = PIL.Image.OPEN[name]
    if name == "JPEG":  # the registered factory also reads blocks of several images
        from PIL.JpegImagePlugin import JpegImageFile as factory
    image: PIL.Image.Image = factory(io.BytesIO(data), "")
    block = _png_exif(data, image.info) if name == "PNG" else image.info.get("exif", b"")
    exif, aspect = read_exif(block)
    header = _upright(name, image.size, exif, _density_aspect(image.info, aspect))
    if complete:
        image.verify()
    return header


def _png_exif(data: bytes, info: Mapping[Any, Any]) -> bytes:
    """The EXIF block of a PNG, a chunk anywhere or a text of ImageMagick's; empty without one."""
    at = max(data.find(b"eXIf" + order) for order in (b"II*\0", b"MM\0*"))
    if at > 0:
        return data[at + 4 :]
    try:  # an empty line, a name and a length, then hexadecimal digits
        return bytes.fromhex(info["Raw profile type exif"].split("\n", 3)[3])
    except (KeyError, IndexError, ValueError):  # the pixels may be intact
        return b""


def _density_aspect(info: Mapping[Any, Any], by_exif: float) -> float:
    """The aspect of a pixel by JFIF or a chunk pHYs of PNG, else by EXIF data. Without a unit the
    numbers are its width to its height, as ffmpeg writes them in both; else pixels a length."""
    pair = info.get("aspect", info.get("jfif_density", info.get("dpi")))
    if not isinstance(pair, tuple):  # none, or a text of that name
        return by_exif
    aspect = _aspect(*(pair if "aspect" in info or info.get("jfif_unit") == 0 else pair[::-1]))
    return by_exif if aspect == 1 else aspect


def _aspect(width: Any, height: Any) -> float:
    """The aspect of a pixel by two numbers; 1 for what is none of a pixel."""
    width, height = _number(width), _number(height)
    aspect = width / height if width and height else 1.0
    return aspect if _PIXEL_ASPECTS[0] <= aspect <= _PIXEL_ASPECTS[1] else 1.0


def _heif_header(data: bytes) -> Header:
    """The EXIF orientation repeats HEIF's own rotation, which is part of decoding."""
    import pillow_heif

    image = pillow_heif.open_heif(data)  # decodes nothing
    exif, _ = read_exif(image.info.get("exif") or b"")
    return Header("HEIF", image.size, replace(exif, orientation=1))


def _upright(
    name: str, size: Size, exif: Exif, pixel_aspect: float, projection: str = ""
) -> Header:
    """The header of an image by the size and the aspect of a pixel as stored."""
    if exif.orientation in EXCHANGING:
        size, pixel_aspect = size[::-1], 1 / pixel_aspect
    return Header(name, size, exif, pixel_aspect, projection)


def read_exif(block: bytes) -> tuple[Exif, float]:
    """The camera, and the aspect of a pixel as stored, of an EXIF block, with or without
    `Exif\\0\\0` before it; of a damaged one as of an empty one."""
    try:
        block = block.removeprefix(b"Exif\0\0")
        tags = _tiff_tags(block)
        directories = [tags[tag] for tag in (EXIF_DIRECTORY, _GPS_DIRECTORY) if tag in tags]
        more = {k: v for offset in directories for k, v in _tiff_tags(block, offset).items()}
        aspect = _aspect(tags.get(_Y_RESOLUTION), tags.get(_X_RESOLUTION))
        return _camera_tags(tags, more), aspect
    except Exception:  # a damaged block raises almost anything
        return Exif(), 1.0


def _camera_tags(first: Mapping[int, Any], more: Mapping[int, Any]) -> Exif:
    """The camera by the tags of the first directory and of those of EXIF and GPS.

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
        _size(more.get(_EXIF_WIDTH), more.get(_EXIF_HEIGHT)),
        _pixels_per_mm(*plane),
        _position(more),
        int(first[_ORIENTATION]) if first.get(_ORIENTATION) in range(2, 9) else 1,
    )


def _position(tags: Mapping[int, Any]) -> tuple[float, float, float] | None:
    """By the tags of GPS; the altitude is 0 without one."""
    try:
        degrees = [sum(float(part) / 60**n for n, part in enumerate(tags[k])) for k in (2, 4)]
        altitude = float(tags.get(6, 0)) * (-1 if tags.get(5) in (1, b"\1") else 1)
    except (KeyError, TypeError, ValueError, ArithmeticError):
        return None
    latitude = -degrees[0] if tags.get(1) == "S" else degrees[0]
    longitude = -degrees[1] if tags.get(3) == "W" else degrees[1]
    is_there = abs(latitude) <= 90 and abs(longitude) <= 180 and math.isfinite(altitude)
    return (latitude, longitude, altitude) if is_there else None


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
