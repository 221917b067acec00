"""An image file: its header, read without decoding pixels, and its pixels as stored.

The first bytes of a file determine its format; the name does not matter. Pillow reads the headers,
OpenCV the pixels, and pillow-heif, if installed, HEIC. A decoder allocates the memory that a header
claims, so an image is decoded only after its size has been checked.
"""

import io
import math
import re
import warnings
from collections.abc import Iterator, Mapping
from contextlib import contextmanager, suppress
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any, BinaryIO

import cv2
import numpy as np
import PIL.Image
from PIL.ExifTags import IFD, Base

from dgc_pose.errors import ImageError, InputError, is_installed, reason
from dgc_pose.geometry.pixels import EXCHANGING, Size
from dgc_pose.system.files import open_file, read_as, read_bytes

# Width times height; larger images are rejected before decoding. Phones take 16,384 x 12,288.
MAX_PIXELS = 210_000_000
_TOO_LARGE = f"is too large: the limit is {MAX_PIXELS} pixels"
PIL.Image.MAX_IMAGE_PIXELS = MAX_PIXELS // 2  # Pillow rejects images above twice this
_MAX_BYTES = 2**31 - 1  # of a file: OpenCV counts them in a signed 32-bit number
_END_BYTES = 2**17  # at both ends of a file, searched for XMP, and in a PNG for EXIF data
_RAW = "RAW"
# Formats by their first bytes, stricter than Pillow's tests; the names are Pillow's.
_FORMATS = {
    name: re.compile(start, re.DOTALL)
    for name, start in {
        "JPEG": rb"\xff\xd8\xff",
        "PNG": rb"\x89PNG\r\n\x1a\n",
        _RAW: rb"II\*\0....CR|.{4}ftypcrx |IIRO|IIRS|MMOR|IIU\0|FUJIFILMCCD-RAW",
        "TIFF": rb"II\*\0|MM\0\*",
        "WEBP": rb"RIFF....WEBP",
        "BMP": rb"BM.{12}[\x0c\x10\x28\x34\x38\x40\x6c\x7c]\0\0\0",
        "PPM": rb"P[1-6](\s*#|\s+\d)",
        "GIF": rb"GIF8[79]a",
        "JPEG2000": rb"\xff\x4f\xff\x51|\0\0\0\x0cjP  \r\n\x87\n",
        "AVIF": rb".{4}ftyp(avi[fs]|mi[af][f1].{4,40}avif)",
        "HEIF": rb".{4}ftyp(hei[cxms]|hev[cxms]|mif1|msf1)",
    }.items()
}
_RAW_FILE = "a camera's raw file, or a TIFF that begins with a thumbnail: convert it to JPEG or PNG"
_UNIT_MM = {2: 25.4, 3: 10.0, 4: 1.0, 5: 0.001}  # of EXIF resolutions; 2 if a file has none
_MAX_ZOOM = 200.0
_MAX_RESOLUTION_DIFFERENCE = 0.02  # relative, between x and y, for square pixels
_MAX_TEXT = 80  # characters of a name
_PIXEL_ASPECTS = (0.25, 4.0)  # plausible range
# In Google's XMP of panoramas, an attribute or an element.
_PROJECTION = re.compile(rb"GPano:ProjectionType[\s=\"'>]+((?i:equirectangular|cylindrical))")


class UnreadableFormatError(ValueError):
    """A file has an unknown or unsupported format. The message states what the file is."""


@dataclass(frozen=True)
class Exif:
    """A camera's EXIF data. Numbers are positive and finite; None if missing."""

    make: str = ""
    model: str = ""
    lens: str = ""
    focal_mm: float | None = None  # of the lens
    # Of a lens with the same field of view on 35 mm film (36 mm x 24 mm)
    focal_35mm: float | None = None
    digital_zoom: float = 1.0  # at least 1
    size: tuple[int, int] | None = None  # (width, height) of the image that the camera wrote
    pixels_per_mm: float | None = None  # of that image, on the sensor
    position: tuple[float, float, float] | None = None  # latitude, longitude, degrees; altitude, m
    orientation: int = 1  # 1 to 8, of the pixels as stored; already applied to a loaded image


@dataclass(frozen=True)
class Header:
    """Facts about the upright image, from the header of its file."""

    format: str  # a key of `_FORMATS`
    size: Size  # (width, height)
    exif: Exif = Exif()
    pixel_aspect: float = 1.0  # width of a pixel over its height; 1 if not stated
    projection: str = ""  # of a panorama, by XMP: "equirectangular" or "cylindrical"


def image_size(path: str | Path) -> Size:
    """(width, height) of the upright image, from the header. Raises ImageError, with the path."""
    return image_header(Path(path)).size


def image_header(path: Path) -> Header:
    """Read the header of an image file. Raises ImageError, with the path."""
    with image_errors(path), open_file(path, ImageError) as stream:
        return _checked_header(stream, path)


def read_pixels(path: str | Path) -> np.ndarray:
    """Read a file's pixels as stored: BGR(A), or values that are not colours, such as depth. Raises
    ImageError, with the path."""
    with image_errors(Path(path)):
        return decoded(Path(path))[0]


@contextmanager
def image_errors(path: Path) -> Iterator[None]:
    """Convert errors in the block, which reads an image, to ImageError."""
    try:
        yield
    except OSError as error:
        raise ImageError(path, f"cannot be read: {error.strerror or error}") from error
    except MemoryError:
        raise ImageError(path, "needs more memory than there is") from None
    except InputError as error:
        raise ImageError(*error.args) from error


def decoded(path: Path) -> tuple[np.ndarray, Header]:
    """Pixels as stored, in the order BGR(A), and the header. HEIC gives 8-bit colours. Call it
    within `image_errors`."""
    data = read_bytes(path, _MAX_BYTES, ImageError)
    header = _checked_header(io.BytesIO(data), path, verify=True)
    if header.format == "HEIF":
        import pillow_heif

        with read_as("HEIC", path, ImageError):
            image = pillow_heif.open_heif(data, convert_hdr_to_8bit=True, bgr_mode=True)
            pixels = np.array(image)
        return cv2.cvtColor(pixels, cv2.COLOR_GRAY2BGR) if pixels.ndim == 2 else pixels, header
    try:
        # Not IMREAD_COLOR: it rotates the image by its EXIF tag and cuts 16 bits to the upper 8.
        array = cv2.imdecode(np.frombuffer(data, np.uint8), cv2.IMREAD_UNCHANGED)
    except cv2.error as error:
        if error.code == cv2.Error.STS_NO_MEM:  # not an error of the file: a batch must not skip it
            raise MemoryError from None
        raise ImageError(path, f"cannot be decoded: {error.err}") from None
    if array is None:  # OpenCV gives no reason
        raise ImageError(path, f"cannot be decoded: OpenCV does not read this {header.format}")
    return array, header


def _checked_header(stream: BinaryIO, path: Path, *, verify: bool = False) -> Header:
    try:
        header = _read_header(stream, verify)
    except UnreadableFormatError as error:
        raise ImageError(path, f"is {error}") from None
    except PIL.Image.DecompressionBombError:
        raise ImageError(path, _TOO_LARGE) from None
    except PIL.UnidentifiedImageError:
        raise ImageError(path, "is corrupt: Pillow does not read it") from None
    except Exception as error:  # readers of formats raise any type
        raise ImageError(path, f"is corrupt: {reason(error)}") from error
    if math.prod(header.size) > MAX_PIXELS:
        width, height = header.size
        raise ImageError(path, f"{_TOO_LARGE}, not {width} x {height}")
    if header.format == "TIFF" and header.exif.orientation != 1:  # OpenCV rotates only some
        turn = header.exif.orientation
        raise ImageError(path, f"is a TIFF with orientation tag {turn}: save it upright")
    return header


def image_format(stream: BinaryIO) -> str:
    """The format of an image file. Raises UnreadableFormatError if it is not supported."""
    start = stream.read(64)
    name = next((name for name, pattern in _FORMATS.items() if pattern.match(start)), None)
    if name is None:
        raise UnreadableFormatError("not an image of a known format" if start else "empty")
    if name == _RAW:
        raise UnreadableFormatError(_RAW_FILE)
    if name == "HEIF" and not is_installed("pillow_heif"):
        raise UnreadableFormatError("HEIC, which needs pillow-heif: pip install '.[heic]'")
    return name


def _read_header(stream: BinaryIO, verify: bool) -> Header:
    """Read the header, from both ends of the file and by Pillow.

    verify: whether to check all checksums of a PNG. Raises UnreadableFormatError if the format is
    not supported, any other exception if the header is damaged.
    """
    name = image_format(stream)
    stream.seek(0)
    ends = stream.read(_END_BYTES)
    stream.seek(max(len(ends), stream.seek(0, io.SEEK_END) - _END_BYTES))
    ends += stream.read()
    stream.seek(0)
    found = _PROJECTION.search(ends)
    tags = PIL.Image.Exif()
    info = dict[Any, Any]()
    with warnings.catch_warnings():
        warnings.simplefilter("ignore")  # about EXIF blocks and huge images
        if name == "TIFF":  # Pillow rejects some that OpenCV decodes: floats in three colours
            tags.load_from_fp(stream)
            if Base.DNGVersion in tags or tags.get(Base.NewSubfileType, 0) & 1:
                raise UnreadableFormatError(_RAW_FILE)
            size = int(tags[Base.ImageWidth]), int(tags[Base.ImageLength])
        else:
            if name == "HEIF":
                import pillow_heif

                image: Any = pillow_heif.open_heif(stream)
            else:
                image = PIL.Image.open(stream, formats=[name])
            size = image.size
            info = image.info
            with suppress(Exception):  # a damaged block raises almost anything
                tags.load(_png_exif(ends, info) if name == "PNG" else info.get("exif") or b"")
            if verify and name != "HEIF":
                image.verify()
        exif, aspect = _exif(tags)
    aspect = _density_aspect(info, aspect)
    if name == "HEIF":  # decoding applies its rotation, which EXIF repeats
        exif = replace(exif, orientation=1)
    if exif.orientation in EXCHANGING:
        size = size[::-1]
        aspect = 1 / aspect
    return Header(name, size, exif, aspect, found[1].decode().lower() if found else "")


def _png_exif(ends: bytes, info: Mapping[Any, Any]) -> bytes:
    """The EXIF block of a PNG, from a chunk or from ImageMagick's text; empty without one. Pillow
    would decode the image to find a chunk after the pixels."""
    at = max(ends.find(b"eXIf" + order) for order in (b"II*\0", b"MM\0*"))
    if at > 0:
        return ends[at + 4 :]
    # An empty line, a name and a length, then hexadecimal digits.
    return bytes.fromhex(info.get("Raw profile type exif", "\n\n\n").split("\n", 3)[3])


def _density_aspect(info: Mapping[Any, Any], by_exif: float) -> float:
    """The aspect of a pixel from JFIF or PNG's pHYs chunk, else `by_exif`. Without a unit, the two
    numbers are the pixel's width and height, as ffmpeg writes them; else pixels per length."""
    pair = info.get("aspect", info.get("jfif_density", info.get("dpi")))
    if not isinstance(pair, tuple):  # none, or a text of that name
        return by_exif
    aspect = _aspect(*(pair if "aspect" in info or info.get("jfif_unit") == 0 else pair[::-1]))
    return by_exif if aspect == 1 else aspect


def _aspect(width: Any, height: Any) -> float:
    """The aspect of a pixel from its width and height; 1 if it is not plausible."""
    width = _number(width)
    height = _number(height)
    aspect = width / height if width and height else 1.0
    return aspect if _PIXEL_ASPECTS[0] <= aspect <= _PIXEL_ASPECTS[1] else 1.0


def _exif(tags: PIL.Image.Exif) -> tuple[Exif, float]:
    """The camera and the aspect of a stored pixel, from an EXIF block or a TIFF. A damaged block
    counts as empty."""
    with suppress(Exception):  # a damaged block raises almost anything
        more = tags.get_ifd(IFD.Exif) | tags.get_ifd(IFD.GPSInfo)
        aspect = _aspect(tags.get(Base.YResolution), tags.get(Base.XResolution))
        return _camera(tags, more), aspect
    return Exif(), 1.0


def _camera(first: PIL.Image.Exif, more: Mapping[int, Any]) -> Exif:
    zoom = _number(more.get(Base.DigitalZoomRatio))
    turn = first.get(Base.Orientation)
    sides = [_number(more.get(side)) for side in (Base.ExifImageWidth, Base.ExifImageHeight)]
    width, height = (int(side) if side and 1 <= side < 2**31 else 0 for side in sides)
    return Exif(
        make=_text(first.get(Base.Make)),
        model=_text(first.get(Base.Model)),
        lens=_text(more.get(Base.LensModel)),
        focal_mm=_number(more.get(Base.FocalLength)),
        focal_35mm=_number(more.get(Base.FocalLengthIn35mmFilm)),
        digital_zoom=zoom if zoom is not None and 1 <= zoom <= _MAX_ZOOM else 1.0,
        size=(width, height) if width and height else None,
        pixels_per_mm=_pixels_per_mm(more),
        position=_position(more),
        orientation=turn if isinstance(turn, int) and 1 <= turn <= 8 else 1,
    )


def _position(tags: Mapping[int, Any]) -> tuple[float, float, float] | None:
    try:
        degrees = [sum(float(part) / 60**n for n, part in enumerate(tags[k])) for k in (2, 4)]
        altitude = float(tags.get(6, 0)) * (-1 if tags.get(5) in (1, b"\1") else 1)
        latitude = degrees[0] * {"N": 1, "S": -1}[tags[1]]
        longitude = degrees[1] * {"E": 1, "W": -1}[tags[3]]
    except (KeyError, TypeError, ValueError, ArithmeticError):
        return None
    is_there = abs(latitude) <= 90 and abs(longitude) <= 180 and math.isfinite(altitude)
    return (latitude, longitude, altitude) if is_there else None


def _number(value: Any) -> float | None:
    """Convert to a positive, finite number, else None; in EXIF, 0 means unknown."""
    if isinstance(value, (str, bytes, tuple)):
        return None
    try:
        number = float(value)
    except (TypeError, ValueError, ArithmeticError):
        return None
    return number if math.isfinite(number) and number > 0 else None


def _text(value: Any) -> str:
    """Convert to one line, without the padding that some cameras write."""
    if not isinstance(value, str):
        return ""
    return " ".join("".join(c if c.isprintable() else " " for c in value).split())[:_MAX_TEXT]


def _pixels_per_mm(tags: Mapping[int, Any]) -> float | None:
    """Resolution on the sensor; None if x and y differ, as for sensors interpolated on one axis."""
    x, y = (_number(tags.get(t)) for t in (Base.FocalPlaneXResolution, Base.FocalPlaneYResolution))
    if x is None or (y is not None and abs(x - y) > _MAX_RESOLUTION_DIFFERENCE * x):
        return None
    unit_mm = _UNIT_MM.get(tags.get(Base.FocalPlaneResolutionUnit, 2))
    return None if unit_mm is None else x / unit_mm
