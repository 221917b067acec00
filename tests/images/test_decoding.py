"""Image files: pixels of every format, EXIF data, and every way in which a file can be unusable."""

import os
import struct
import zlib
from pathlib import Path
from typing import Any

import cv2
import numpy as np
import PIL.Image
import PIL.ImageOps
import pytest
from PIL.TiffImagePlugin import IFDRational

from dgc_pose.errors import ImageError
from dgc_pose.images.decoding import Exif, image_header, image_size, read_pixels
from dgc_pose.images.image import load_image, size_in_file

pytestmark = pytest.mark.filterwarnings("ignore")  # of Pillow, about damaged blocks

NOISE = np.random.default_rng(0).integers(0, 256, (300, 400, 3), np.uint8)  # over 2**17 bytes
FOCAL = 0x920A
FILM = 0xA405
ZOOM = 0xA404
LENS = 0xA434
WIDTH = 0xA002
HEIGHT = 0xA003
PLANE_X = 0xA20E
PLANE_Y = 0xA20F
PLANE_UNIT = 0xA210
TAGS = {
    FOCAL: IFDRational(51, 10),
    FILM: 26,
    ZOOM: IFDRational(3, 2),
    LENS: "back camera 5.1mm f/1.6",
    WIDTH: 4032,
    HEIGHT: 3024,
    PLANE_X: IFDRational(10000, 1),
    PLANE_Y: IFDRational(10000, 1),
    PLANE_UNIT: 3,
}
KNOWN = Exif(
    make="Apple",
    model="iPhone 13",
    lens="back camera 5.1mm f/1.6",
    focal_mm=5.1,
    focal_35mm=26,
    digital_zoom=1.5,
    size=(4032, 3024),
    pixels_per_mm=1000,  # 10000 a centimetre
)


def save(path: Path, pixels: np.ndarray, format: str = "", **more: Any) -> Path:
    """Saves with Pillow, an independent writer. format: by default that of the ending."""
    ending = path.suffix[1:].upper()
    format = format or {"JPG": "JPEG", "HEIC": "HEIF"}.get(ending, ending)
    if format == "HEIF":
        pytest.importorskip("pillow_heif").register_heif_opener()
        more |= {"quality": -1, "chroma": 444}
    else:
        more |= {"lossless": True} if format == "WEBP" else {"quality": 100}
    PIL.Image.fromarray(pixels).save(path, format, **more)
    return path


def orientation_tag(orientation: int) -> PIL.Image.Exif:
    exif = PIL.Image.Exif()
    exif[274] = orientation
    return exif


@pytest.mark.parametrize("suffix", ["png", "tiff", "bmp", "ppm", "jpg", "webp", "heic"])
def test_a_file_gives_its_pixels_in_rgb_and_is_refused_if_it_is_truncated(
    tmp_path: Path, rgb: np.ndarray, suffix: str
) -> None:
    path = save(tmp_path / f"picture.{suffix}", rgb)
    image = load_image(path)
    assert (image.size, image.name, image.exif.orientation) == ((70, 50), str(path), 1)
    assert image.pixels.dtype == np.uint8 and image.pixels.flags.c_contiguous
    difference = np.abs(image.pixels.astype(int) - rgb)
    assert difference.mean() < 3 if suffix in ("jpg", "heic") else difference.max() == 0
    np.testing.assert_array_equal(load_image(str(path)).pixels, image.pixels)
    data = path.read_bytes()
    for share in (0.02, 0.5, 0.95):
        path.write_bytes(data[: max(2, int(len(data) * share))])
        with pytest.raises(ImageError, match=r"picture\.") as caught:
            load_image(path)
        assert caught.value.path == path


@pytest.mark.parametrize("suffixes", [("jpg", "png", "webp"), ("heic",)], ids=["all", "heic"])
@pytest.mark.parametrize("orientation", [1, 2, 4, 6, 7])
def test_an_image_is_upright_as_pillow_shows_it(
    tmp_path: Path, rgb: np.ndarray, orientation: int, suffixes: tuple[str, ...]
) -> None:
    """An orientation becomes HEIF's own rotation, as in the files of telephones, and decoding
    applies that."""
    exif = orientation_tag(orientation)
    for suffix in suffixes:
        image = load_image(save(tmp_path / f"turned.{suffix}", rgb, exif=exif.tobytes()))
        stored = PIL.Image.fromarray(load_image(save(tmp_path / f"a.{suffix}", rgb)).pixels)
        stored.getexif()[274] = orientation
        np.testing.assert_array_equal(image.pixels, PIL.ImageOps.exif_transpose(stored))
        assert image.pixels.flags.c_contiguous
        assert image_size(image.name) == image.size
        applied = suffix == "heic"
        assert image.exif.orientation == (1 if applied else orientation)
        assert size_in_file(image) == (image.size if applied else stored.size)
    if orientation > 1:
        path = save(tmp_path / "turned.tiff", rgb, exif=exif)
        with pytest.raises(ImageError, match=r"turned\.tiff is a TIFF with orientation tag \d:"):
            load_image(path)


def test_files_of_other_channels_and_depths_become_rgb_of_8_bits(
    tmp_path: Path, rgb: np.ndarray
) -> None:
    """16 bits are stretched from their range."""
    for mode in ("LA", "P", "1"):
        converted = PIL.Image.fromarray(rgb).convert(mode)
        if mode == "LA":
            converted.putalpha(77)
        converted.save(tmp_path / "a.png")
        expected = np.asarray(converted.convert("RGBA"))[:, :, :3]
        np.testing.assert_array_equal(load_image(tmp_path / "a.png").pixels, expected)
    low = int(rgb.min())
    high = int(rgb.max())
    stretched = np.round((rgb.astype(float) - low) / (high - low) * 255)
    for suffix, top in (("png", 65535), ("tiff", 4095)):
        path = tmp_path / f"deep.{suffix}"
        assert cv2.imwrite(str(path), rgb[:, :, ::-1].astype(np.uint16) * (top // 255) // 2 + 100)
        assert np.abs(load_image(path).pixels - stretched).max() <= 1
        assert read_pixels(path).dtype == np.uint16


def test_heic_of_other_channels_and_depths_becomes_rgb_of_8_bits(
    tmp_path: Path, rgb: np.ndarray
) -> None:
    pillow_heif = pytest.importorskip("pillow_heif")
    grey = np.repeat(rgb[:, :, :1], 3, axis=2)
    for mode, values in (("L", grey[:, :, 0]), ("RGB;16", grey.astype(np.uint16) * 257)):
        made = pillow_heif.from_bytes(mode, (70, 50), values.tobytes())
        made.save(tmp_path / "a.heic", quality=-1, chroma=444)
        assert np.abs(load_image(tmp_path / "a.heic").pixels.astype(int) - grey).mean() < 3


def raw_file(order: str, tag: int, value: int) -> bytes:
    """A TIFF whose tags, one of them of a thumbnail or of a DNG, are at the end."""
    start = b"II*\0" if order == "<" else b"MM\0*"
    at = 200_000
    tags = struct.pack(order + "HHHIIHHIII", 2, 256, 4, 1, 9, tag, 4, 1, value, 0)
    return start + struct.pack(order + "I", at) + bytes(at - 8) + tags


UNKNOWN = "is not an image of a known format"
RAW = "is a camera's raw file, or a TIFF that begins with a thumbnail"


@pytest.mark.parametrize(
    ("content", "error"),
    [
        (b"", "is empty"),
        (b"hello", UNKNOWN),
        (b"P2: 718.9 0 607.2 0", UNKNOWN),  # KITTI's calib.txt
        (b"\0\0\0\x14ftypqt  \0\0\0\0qt  " + b"\0" * 99, UNKNOWN),
        (b"\xff\xd8\xff", "is corrupt: Pillow does not read it"),
        (b"II*\0\x08" + bytes(12), "is corrupt: "),
        (b"II*\0\x10\0\0\0CR\2\0" + b"\0" * 99, RAW),
        (raw_file("<", 254, 1), RAW),
        (raw_file(">", 50706, 0x0401), RAW),
        (b"P6\n60000 50000\n255\n" + bytes(100), "is too large: "),
    ],
)
def test_a_file_that_cannot_be_read(tmp_path: Path, content: bytes, error: str) -> None:
    path = tmp_path / "photo.jpg"
    path.write_bytes(content)
    for read in (load_image, image_size):
        with pytest.raises(ImageError) as caught:
            read(path)
        assert str(caught.value).startswith(f"{path} {error}") and caught.value.path == path


def test_a_missing_file_a_folder_a_pipe_and_a_large_file(tmp_path: Path) -> None:
    """An image from a telephone may be larger than Pillow's own limit."""
    os.mkfifo(tmp_path / "pipe")
    (tmp_path / "large.png").touch()
    os.truncate(tmp_path / "large.png", 2**31)
    (tmp_path / "phone.ppm").write_bytes(b"P6\n16384 12288\n255\n" + bytes(100))
    for name, words in (
        ("gone.png", r"gone\.png cannot be read: No such file"),
        ("x" * 5000, "cannot be read"),
        ("", "is a folder"),
        ("pipe", "is not a regular file"),
        ("a\0b", "is not a regular file"),
        ("large.png", r"large\.png is too large"),
        ("phone.ppm", r"phone\.ppm cannot be decoded: OpenCV does not read"),
    ):
        with pytest.raises(ImageError, match=words):
            load_image(tmp_path / name)
    assert image_size(tmp_path / "phone.ppm") == (16384, 12288)


def block_of(tags: dict[int, Any], make: str = "Apple", gps: dict[int, Any] | None = None) -> bytes:
    exif = PIL.Image.Exif()
    exif[271] = make
    exif[272] = "iPhone 13"
    exif.get_ifd(0x8769).update(tags)
    exif.get_ifd(0x8825).update(gps or {})
    return exif.tobytes()


def add_chunk(path: Path, kind: bytes, content: bytes, *, behind: bool = False) -> None:
    """To a PNG, behind its first chunk or behind its pixels."""
    data = path.read_bytes()
    chunk = struct.pack(">I", len(content)) + kind + content
    chunk += struct.pack(">I", zlib.crc32(kind + content))
    at = len(data) - 12 if behind else 33
    path.write_bytes(data[:at] + chunk + data[at:])


def profile(block: bytes) -> bytes:
    """A block as a text, which ImageMagick writes."""
    lines = [block.hex()[i : i + 72] for i in range(0, 2 * len(block), 72)]
    return "\n".join(["", "exif", f"{len(block):8}", *lines, ""]).encode("ascii")


def with_blocks(path: Path, way: str, block: bytes, xmp: bytes) -> None:
    """A file with EXIF data and XMP in one of the ways that formats have them."""
    format, _, how = way.partition(", ")
    if format == "PNG":
        save(path, NOISE, format)
        name = b"Raw profile type exif\0"
        chunk = {
            "text": (b"tEXt", name + profile(block)),
            "damaged": (b"tEXt", name + b"\nexif\n      8\nno digits"),
        }.get(how, (b"eXIf", block.removeprefix(b"Exif\0\0")))
        for kind, content in (chunk, (b"iTXt", b"XML:com.adobe.xmp\0\0\0\0\0" + xmp)):
            add_chunk(path, kind, content, behind=how == "behind")
    elif format == "TIFF":
        exif = PIL.Image.Exif()
        exif.load(block)
        exif[700] = xmp
        save(path, NOISE, format, exif=exif)
    else:
        save(path, NOISE, format, exif=block, xmp=xmp)


@pytest.mark.parametrize(
    "way",
    ["JPEG", "PNG", "PNG, behind", "PNG, text", "PNG, damaged", "WEBP", "TIFF", "HEIF"],
)
def test_every_format_has_its_blocks_in_the_header_as_in_the_file(tmp_path: Path, way: str) -> None:
    """More than the first bytes must be read: WebP and TIFF have them last."""
    path = tmp_path / "photo"
    for text, projection in (
        ('<a GPano:ProjectionType="Equirectangular"/>', "equirectangular"),
        ("<GPano:ProjectionType>cylindrical</GPano:ProjectionType>", "cylindrical"),
        ('<a GPano:ProjectionType="rectilinear"/>', ""),
    ):
        with_blocks(path, way, block_of(TAGS), f"<x:xmpmeta>{text}</x:xmpmeta>".encode())
        assert path.stat().st_size > 2**17
        for found in (image_header(path), load_image(path)):
            assert found.exif == (Exif() if way == "PNG, damaged" else KNOWN)
            assert found.projection == projection


def exif_of(folder: Path, block: bytes) -> Exif:
    PIL.Image.new("L", (8, 8)).save(folder / "a.webp", exif=block)
    return image_header(folder / "a.webp").exif


@pytest.mark.parametrize(
    ("tag", "values", "field"),
    [
        (FOCAL, [IFDRational(0, 1), IFDRational(1, 0), "5.1", float("nan"), (5, 5)], "focal_mm"),
        (WIDTH, [0, -1, "4032", (1, 2), 0.5], "size"),
        (PLANE_UNIT, [1, 0, 6, "cm"], "pixels_per_mm"),
        # The last one is half of that along y: the pixels are not square.
        (PLANE_X, [0, IFDRational(1, 0), "many", IFDRational(5000, 1)], "pixels_per_mm"),
    ],
)
def test_a_number_that_is_not_positive_is_not_known(
    tmp_path: Path, tag: int, values: list[Any], field: str
) -> None:
    for value in values:
        assert getattr(exif_of(tmp_path, block_of(TAGS | {tag: value})), field) is None, value


def test_units_of_a_resolution_hemispheres_of_a_position_and_a_name_in_one_line(
    tmp_path: Path,
) -> None:
    for unit, per_mm in ((2, 10000 / 25.4), (4, 10000), (5, 1e7)):
        exif = exif_of(tmp_path, block_of(TAGS | {PLANE_UNIT: unit}, "a\nb" + "c" * 500))
        assert exif.pixels_per_mm == pytest.approx(per_mm)
        assert exif.make.startswith("a bccc") and len(exif.make) == 80
    numbers = {2: (33.0, 30.0, 0.0), 4: (70.0, 15.0, 0.0), 6: 12.0}
    for letters, position in (("SE", (-33.5, 70.25, 12.0)), ("S", None), ("WS", None)):
        gps = numbers | dict(zip((1, 3), letters, strict=False))
        assert exif_of(tmp_path, block_of({}, gps=gps)).position == position


@pytest.mark.parametrize(
    ("suffix", "unit", "along_x", "along_y", "aspect"),
    [
        ("jpg", 0, 4, 3, 4 / 3),  # ffmpeg's frames of a video of 4:3 pixels
        ("jpg", 1, 72, 96, 4 / 3),  # dots an inch: the pixel is the wider the fewer there are
        ("jpg", 0, 65535, 1, 1),
        ("png", 0, 4, 3, 4 / 3),
        ("tiff", 2, 204, 98, 98 / 204),  # a fax
        ("webp", 2, 150, 300, 0.5),  # EXIF data of an image turned by 90 degrees
        ("jpeg", 2, 150, 300, 0.5),  # and where JFIF states nothing
    ],
)
def test_the_shape_of_a_pixel(
    tmp_path: Path, suffix: str, unit: int, along_x: int, along_y: int, aspect: float
) -> None:
    """By JFIF, by a chunk of PNG, by the tags of a TIFF, or by EXIF data."""
    exif = orientation_tag(6 if suffix in ("webp", "jpeg") else 1)
    if suffix not in ("jpg", "png"):
        exif[282] = along_x
        exif[283] = along_y
        exif[296] = unit
    path = save(tmp_path / f"a.{suffix}", NOISE, exif=exif)
    if suffix == "png":
        add_chunk(path, b"pHYs", struct.pack(">IIB", along_x, along_y, unit))
    if suffix == "jpg":
        data = bytearray(path.read_bytes())
        assert data[6:11] == b"JFIF\0"
        data[13:18] = struct.pack(">BHH", unit, along_x, along_y)
        path.write_bytes(data)
    for stated in (image_header(path), load_image(path)):
        assert stated.pixel_aspect == pytest.approx(aspect, rel=1e-6)
