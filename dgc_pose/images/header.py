"""What an encoded image says of itself: format, size, orientation, without decoding a pixel.

A file's format is told by its first bytes, never by its name. Pillow reads the headers, OpenCV the
pixels; pillow-heif, where it is installed, reads HEIC. A decoder takes memory for what a header
claims, so nothing is decoded whose size is not known first.
"""

from __future__ import annotations

import importlib.util
import io
import re
import struct
import warnings
from dataclasses import dataclass
from typing import Any

import PIL.Image

START_BYTES = 4096  # of a file, by which its format is told
_RAW = "RAW"
# The formats by their first bytes; the names are Pillow's where it has the format.
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
        "SUN": rb"\x59\xa6\x6a\x95",
        "HDR": rb"#\?R",
        "PFM": rb"P[Ff]\s+\d",
        "PAM": rb"P7\s",
    }.items()
}
_ORIENTATION, _WIDTH, _HEIGHT = 0x0112, 256, 257  # tags of EXIF and TIFF
_KIND, _DNG_VERSION = 254, 50706  # tags of TIFF; the lowest bit of the kind is that of a thumbnail
_PNG = b"\x89PNG\r\n\x1a\n"
_J2K = b"\xff\x4f\xff\x51"  # the beginning of a JPEG 2000 code stream, its size next
_SIZE_OF = {  # where formats whose header is text have their size
    "HDR": re.compile(rb"\n-Y (?P<height>\d{1,9}) \+X (?P<width>\d{1,9})\n"),
    "PFM": re.compile(rb"P[Ff]\s+(?P<width>\d{1,9})\s+(?P<height>\d{1,9})\s"),
    "PAM": re.compile(rb"\nWIDTH (?P<width>\d{1,9})\nHEIGHT (?P<height>\d{1,9})\n"),
}


class UnreadableFormatError(ValueError):
    """A file's format is not known, or is not read. The message says what the file is."""


@dataclass(frozen=True)
class Header:
    """What an encoded image says of itself."""

    format: str  # a key of `_FORMATS`
    size: tuple[int, int]  # (width, height) as it is decoded
    orientation: int = 1  # by EXIF, 1 to 8; 1 is upright. HEIF's own rotation is part of decoding
    exif: bytes = b""  # the EXIF block, if it lies apart from the image's own tags


def unreadable(start: bytes) -> str | None:
    """What a file is that begins so and is not read; None if it is an image that is read.

    start: the first `START_BYTES` of the file, or all of a smaller one.
    """
    name = _format(start)
    if name is None:
        return "not an image of a known format"
    if name == _RAW:
        return "a camera's raw file, or begins with a thumbnail, and neither is read"
    if name == "HEIF" and importlib.util.find_spec("pillow_heif") is None:
        return "HEIC, which needs pillow-heif: pip install pillow-heif"
    return None


def read_header(data: bytes, *, complete: bool = True) -> Header:
    """The header of an encoded image. The checksums of a PNG are checked too.

    complete: whether `data` is all of the file, and not its beginning.

    Raises UnreadableFormatError if the format is not read, any other exception if the header is
    damaged.
    """
    start = data[:START_BYTES]
    if why := unreadable(start):
        raise UnreadableFormatError(why)
    name = str(_format(start))
    if complete and name == "PNG":
        _check_chunks(data)
    with warnings.catch_warnings():
        warnings.simplefilter("ignore")  # about EXIF blocks and huge images
        if name == "HEIF":
            return _by_pillow_heif(data)
        if name in _SIZE_OF:
            return _by_text(data, name)
        return _by_pillow(data, name, complete)


def _format(start: bytes) -> str | None:
    """The format of a file by its beginning; None if it is not known."""
    name = next((name for name, pattern in _FORMATS.items() if pattern.match(start)), None)
    return _RAW if name == "TIFF" and _is_raw(start) else name


def _is_raw(start: bytes) -> bool:
    """Whether the first image of a TIFF is a thumbnail or a sensor's mosaic, as raw files have."""
    if b"+" in start[2:4]:  # as large as scans are
        return False
    order = "<" if start[:1] == b"I" else ">"
    try:
        (at,) = struct.unpack_from(order + "I", start, 4)
        (count,) = struct.unpack_from(order + "H", start, at)
        for entry in range(at + 2, at + 2 + 12 * count, 12):
            tag, _, _, value = struct.unpack_from(order + "HHII", start, entry)
            if tag == _DNG_VERSION or (tag == _KIND and value & 1):
                return True
    except struct.error:  # the tags lie farther behind, or are cut off
        pass
    return False


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


def _by_pillow(data: bytes, name: str, complete: bool) -> Header:
    """Not through PIL.Image.open, which refuses 179 million pixels and more: phones take such
    images."""
    PIL.Image.preinit()  # of the frequent formats: it takes a tenth of the time of all
    if name not in PIL.Image.OPEN:
        PIL.Image.init()
    if name not in PIL.Image.OPEN:
        raise UnreadableFormatError(f"{name}, which this Pillow does not read")
    factory, _ = PIL.Image.OPEN[name]
    if name == "JPEG":  # the registered factory also reads blocks of several images
        from PIL.JpegImagePlugin import JpegImageFile as factory
    try:
        image: PIL.Image.Image = factory(io.BytesIO(data), "")
    except Exception:  # of variants that OpenCV decodes, too
        if name == "TIFF":
            return _by_tags(data)
        if name == "JPEG2000":
            return _by_code_stream(data)
        raise
    header = Header(name, image.size, _orientation(image), image.info.get("exif", b""))
    if complete:
        image.verify()  # the checksums of a PNG
    return header


def _by_pillow_heif(data: bytes) -> Header:
    """The EXIF orientation repeats the rotation that decoding applies: it counts no more."""
    import pillow_heif

    image = pillow_heif.open_heif(data)  # decodes nothing
    pillow_heif.set_orientation(image.info)
    return Header("HEIF", image.size, exif=image.info.get("exif") or b"")


def _by_tags(data: bytes) -> Header:
    from PIL.TiffImagePlugin import ImageFileDirectory_v2

    stream = io.BytesIO(data)
    directory: Any = ImageFileDirectory_v2(stream.read(16 if b"+" in data[2:4] else 8))
    stream.seek(directory.next)
    directory.load(stream)
    size = (int(directory[_WIDTH]), int(directory[_HEIGHT]))
    return Header("TIFF", size, int(directory.get(_ORIENTATION, 1)))


def _by_code_stream(data: bytes) -> Header:
    stream_start = data.find(_J2K, 0, 2**16)
    if stream_start < 0:
        raise ValueError("it has no code stream")
    right, bottom, left, top = struct.unpack_from(">4I", data, stream_start + 8)
    return Header("JPEG2000", (right - left, bottom - top))


def _by_text(data: bytes, name: str) -> Header:
    size = _SIZE_OF[name].search(data, 0, 2**16)
    if size is None:
        raise ValueError("its header says no width and height")
    return Header(name, (int(size["width"]), int(size["height"])))


def _orientation(image: PIL.Image.Image) -> int:
    if image.format != "TIFF" and "exif" not in image.info:
        return 1  # getexif would decode all of a PNG without EXIF data
    try:
        found = int(image.getexif().get(_ORIENTATION, 1))
    except Exception:  # a broken EXIF block raises almost anything; the pixels are intact
        return 1
    return found if found in range(2, 9) else 1
