"""The header of an encoded image: format, size and orientation, without decoding a pixel.

A file has the format of its first bytes, whatever its name. Pillow reads the headers, OpenCV the
pixels; pillow-heif, where it is installed, reads HEIC. A decoder takes memory for what a header
claims, so an image is decoded only after its size is known.
"""

import io
import re
import warnings
from dataclasses import dataclass
from typing import Any

import PIL.Image

from dgc_pose.errors import is_installed
from dgc_pose.images.exif import EXIF_DIRECTORY, MAKE, MODEL, Exif, camera_tags, read_exif

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


class UnreadableFormatError(ValueError):
    """A file's format is not known, or is not read. The message names what the file is."""


@dataclass(frozen=True)
class Header:
    """Format, size and EXIF data of an encoded image."""

    format: str  # a key of `_FORMATS`
    size: tuple[int, int]  # (width, height) as it is decoded
    orientation: int = 1  # by EXIF, 1 to 8; 1 is upright. HEIF's own rotation is part of decoding
    exif: Exif = Exif()


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

    complete: whether `data` is all of the file, and not its beginning; then the checksums of a PNG
    are checked.

    Raises UnreadableFormatError if the format is not read, any other exception if the header is
    damaged.
    """
    name = image_format(data)
    with warnings.catch_warnings():
        warnings.simplefilter("ignore")  # about EXIF blocks and huge images
        if name == "HEIF":
            return _heif_header(data)
        if name == "TIFF":
            tags = _tiff_tags(data)
            if not complete and any(tag in tags for tag in (EXIF_DIRECTORY, MAKE, MODEL)):
                raise ValueError("the EXIF data may lie behind the start")
            size = (int(tags[_WIDTH]), int(tags[_HEIGHT]))
            return Header(name, size, _known(tags.get(_ORIENTATION, 1)), _tiff_exif(data, tags))
        return _pillow_header(data, name, complete)


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


def _tiff_exif(data: bytes, tags: Any) -> Exif:
    try:
        more = _tiff_tags(data, tags[EXIF_DIRECTORY]) if EXIF_DIRECTORY in tags else {}
        return camera_tags(tags, more)
    except Exception:  # the pixels may be intact
        return Exif()


def _pillow_header(data: bytes, name: str, complete: bool) -> Header:
    """Not by PIL.Image.open, which refuses 179 million pixels: telephones take such images."""
    PIL.Image.init()
    if name not in PIL.Image.OPEN:
        raise UnreadableFormatError(f"{name}, which this Pillow does not read")
    factory, _ = PIL.Image.OPEN[name]
    if name == "JPEG":  # the registered factory also reads blocks of several images
        from PIL.JpegImagePlugin import JpegImageFile as factory
    image: PIL.Image.Image = factory(io.BytesIO(data), "")
    header = Header(name, image.size, _orientation(image), read_exif(image.info.get("exif", b"")))
    if complete:
        image.verify()
    return header


def _heif_header(data: bytes) -> Header:
    """The EXIF orientation repeats the rotation that decoding applies: it counts no more."""
    import pillow_heif

    image = pillow_heif.open_heif(data)  # decodes nothing
    pillow_heif.set_orientation(image.info)
    return Header("HEIF", image.size, exif=read_exif(image.info.get("exif") or b""))


def _orientation(image: PIL.Image.Image) -> int:
    if "exif" not in image.info:
        return 1  # getexif would decode all of a PNG without EXIF data
    try:
        return _known(image.getexif().get(_ORIENTATION, 1))
    except Exception:  # a broken EXIF block raises almost anything; the pixels are intact
        return 1


def _known(orientation: Any) -> int:
    return int(orientation) if orientation in range(2, 9) else 1
