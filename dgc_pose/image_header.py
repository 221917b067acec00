"""What the header of an encoded image says: format, size, orientation, without decoding a pixel.

Pillow reads the headers and OpenCV the pixels. A decoder takes memory for what a header claims, so
nothing is decoded whose size is not known first.
"""

from __future__ import annotations

import io
import re
import struct
import warnings
from dataclasses import dataclass
from typing import Any

import PIL.Image

# The formats whose header Pillow reads and whose pixels OpenCV decodes.
_FORMATS = ("JPEG", "PNG", "TIFF", "WEBP", "BMP", "PPM", "GIF", "JPEG2000", "AVIF", "SUN")
_ORIENTATION, _WIDTH, _HEIGHT = 0x0112, 256, 257  # tags of EXIF and TIFF
_PNG = b"\x89PNG\r\n\x1a\n"
_J2K = b"\xff\x4f\xff\x51"  # the beginning of a JPEG 2000 code stream, its size next
_BY_TEXT = {  # formats whose header is text: how they begin, and where their size is
    "HDR": (b"#?R", re.compile(rb"\n-Y (?P<height>\d{1,9}) \+X (?P<width>\d{1,9})\n")),
    "PFM": (b"PF", re.compile(rb"PF\s+(?P<width>\d{1,9})\s+(?P<height>\d{1,9})\s")),
    "PAM": (b"P7", re.compile(rb"\nWIDTH (?P<width>\d{1,9})\nHEIGHT (?P<height>\d{1,9})\n")),
}


@dataclass(frozen=True)
class Header:
    """What an encoded image says of itself."""

    format: str  # Pillow's name
    size: tuple[int, int]  # (width, height) as stored
    orientation: int = 1  # by EXIF, 1 to 8; 1 is upright


def read_header(data: bytes, *, complete: bool = True) -> Header:
    """The header of an encoded image. The checksums of a PNG are checked too.

    complete: whether `data` is all of the file, and not its beginning.

    Raises any exception if the format is not known or the header is damaged.
    """
    if complete and data.startswith(_PNG):
        _check_chunks(data)
    with warnings.catch_warnings():
        warnings.simplefilter("ignore")  # about EXIF blocks and huge images
        return _by_pillow(data, complete) or _by_hand(data)


def _check_chunks(data: bytes) -> None:
    """Raise ValueError if a chunk of a PNG claims more bytes than there are: readers would take
    memory for them."""
    position = len(_PNG)
    while position + 8 <= len(data):
        length, kind = struct.unpack_from(">I4s", data, position)
        position += 12 + length
        if position > len(data):
            raise ValueError(f"a chunk of {length} bytes, which the file has not")
        if kind == b"IEND":
            return
    raise ValueError("it has no end")


def _by_pillow(data: bytes, complete: bool) -> Header | None:
    """None if Pillow knows the format, or its variant, not.

    Not through PIL.Image.open, which refuses 179 million pixels and more: phones take such images.
    """
    PIL.Image.preinit()  # of the frequent formats: it takes a tenth of the time of all
    name = _accepted(data)
    if name is None:
        PIL.Image.init()
        name = _accepted(data)
    if name is None:
        return None
    factory, _ = PIL.Image.OPEN[name]
    if name == "JPEG":  # the registered factory also reads blocks of several images
        from PIL.JpegImagePlugin import JpegImageFile as factory
    try:
        image: PIL.Image.Image = factory(io.BytesIO(data), "")
    except Exception:
        if name in ("TIFF", "JPEG2000", "PPM"):
            return None  # variants that OpenCV decodes
        raise
    header = Header(name, image.size, _orientation(image))
    if complete:
        image.verify()  # the checksums of a PNG
    return header


def _accepted(data: bytes) -> str | None:
    """The format, of those that Pillow has made ready, that the data begin as."""
    for name in _FORMATS:
        _, accept = PIL.Image.OPEN.get(name, (None, None))
        if accept is not None and accept(data[:16]) is True:
            return name
    return None


def _by_hand(data: bytes) -> Header:
    """The size of variants that Pillow does not know."""
    if data[:4] in (b"II*\0", b"MM\0*", b"II+\0", b"MM\0+"):
        from PIL.TiffImagePlugin import ImageFileDirectory_v2

        stream = io.BytesIO(data)
        directory: Any = ImageFileDirectory_v2(stream.read(16 if b"+" in data[2:4] else 8))
        stream.seek(directory.next)
        directory.load(stream)
        size = (int(directory[_WIDTH]), int(directory[_HEIGHT]))
        return Header("TIFF", size, int(directory.get(_ORIENTATION, 1)))
    stream_start = data.find(_J2K, 0, 2**16)
    if stream_start >= 0:
        right, bottom, left, top = struct.unpack_from(">4I", data, stream_start + 8)
        return Header("JPEG2000", (right - left, bottom - top))
    for name, (start, size_of) in _BY_TEXT.items():
        if data.startswith(start) and (found := size_of.search(data, 0, 2**16)):
            return Header(name, (int(found["width"]), int(found["height"])))
    raise ValueError("no format of image that is known")


def _orientation(image: PIL.Image.Image) -> int:
    if image.format != "TIFF" and "exif" not in image.info:
        return 1  # getexif would decode all of a PNG without EXIF data
    try:
        found = int(image.getexif().get(_ORIENTATION, 1))
    except Exception:  # a broken EXIF block raises almost anything; the pixels are intact
        return 1
    return found if found in range(2, 9) else 1
