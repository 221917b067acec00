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

FORMATS = ("png", "tiff", "bmp", "ppm", "jpg", "webp")
NOISE = np.random.default_rng(0).integers(0, 256, (300, 400, 3), np.uint8)  # over 2**17 bytes
FOCAL, FILM, ZOOM, LENS = 0x920A, 0xA405, 0xA404, 0xA434
WIDTH, HEIGHT, PLANE_X, PLANE_Y, PLANE_UNIT = 0xA002, 0xA003, 0xA20E, 0xA20F, 0xA210
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


def save(path: Path, pixels: np.ndarray, orientation: int | None = None) -> Path:
    """Saves with Pillow, an independent writer."""
    image = PIL.Image.fromarray(pixels)
    exif = image.getexif()
    if orientation is not None:
        exif[0x0112] = orientation
    lossless = {"lossless": True} if path.suffix == ".webp" else {"quality": 95}
    image.save(path, exif=exif, **lossless)
    return path


def with_chunk(png: bytes, kind: bytes, content: bytes, *, behind: bool = False) -> bytes:
    """A PNG with one chunk more, behind its first chunk or behind its pixels."""
    chunk = struct.pack(">I", len(content)) + kind + content
    chunk += struct.pack(">I", zlib.crc32(kind + content))
    at = len(png) - 12 if behind else 33
    return png[:at] + chunk + png[at:]


def block_of(tags: dict[int, Any], make: str = "Apple", model: str = "iPhone 13") -> bytes:
    exif = PIL.Image.Exif()
    exif[271], exif[272] = make, model
    exif.get_ifd(0x8769).update(tags)
    return exif.tobytes()


def exif_of(folder: Path, block: bytes) -> Exif:
    PIL.Image.new("L", (8, 8)).save(folder / "a.webp", exif=block)
    return image_header(folder / "a.webp").exif


@pytest.mark.parametrize("suffix", FORMATS)
def test_a_file_gives_its_pixels_in_rgb_and_is_refused_if_it_is_truncated(
    tmp_path: Path, rgb: np.ndarray, suffix: str
) -> None:
    path = save(tmp_path / f"picture.{suffix}", rgb)
    image = load_image(path)
    assert (image.size, image.name, image.exif.orientation) == ((70, 50), str(path), 1)
    assert image.pixels.dtype == np.uint8 and image.pixels.flags.c_contiguous
    difference = np.abs(image.pixels.astype(int) - rgb)
    assert difference.max() == 0 if suffix != "jpg" else difference.mean() < 3
    np.testing.assert_array_equal(load_image(str(path)).pixels, image.pixels)
    data = path.read_bytes()
    for share in (0.02, 0.5, 0.95):
        path.write_bytes(data[: max(2, int(len(data) * share))])
        with pytest.raises(ImageError, match=r"picture\.") as caught:
            load_image(path)
        assert caught.value.path == path


@pytest.mark.parametrize("orientation", [1, 2, 4, 6, 7])
def test_an_image_is_upright_as_pillow_shows_it(
    tmp_path: Path, rgb: np.ndarray, orientation: int
) -> None:
    for suffix in ("jpg", "png", "webp"):
        path = save(tmp_path / f"turned.{suffix}", rgb, orientation)
        image = load_image(path)
        stored = PIL.Image.fromarray(load_image(save(tmp_path / f"a.{suffix}", rgb)).pixels)
        stored.getexif()[0x0112] = orientation
        np.testing.assert_array_equal(image.pixels, PIL.ImageOps.exif_transpose(stored))
        assert image.exif.orientation == orientation and image.pixels.flags.c_contiguous
        assert image_size(path) == image.size and size_in_file(image) == stored.size
    if orientation > 1:
        path = save(tmp_path / "turned.tiff", rgb, orientation)
        with pytest.raises(ImageError, match=r"turned\.tiff is a TIFF with orientation tag \d:"):
            load_image(path)


@pytest.mark.parametrize(("suffix", "top"), [("png", 65535), ("tiff", 4095)])
def test_16_bits_are_stretched_from_their_range(
    tmp_path: Path, rgb: np.ndarray, suffix: str, top: int
) -> None:
    path = tmp_path / f"deep.{suffix}"
    assert cv2.imwrite(str(path), rgb[:, :, ::-1].astype(np.uint16) * (top // 255) // 2 + 100)
    low, high = int(rgb.min()), int(rgb.max())
    expected = np.round((rgb.astype(float) - low) / (high - low) * 255)
    assert np.abs(load_image(path).pixels - expected).max() <= 1
    assert read_pixels(path).dtype == np.uint16


@pytest.mark.parametrize("mode", ["LA", "P", "1"])
def test_grey_alpha_and_palette_files_become_rgb(
    tmp_path: Path, rgb: np.ndarray, mode: str
) -> None:
    converted = PIL.Image.fromarray(rgb).convert(mode)
    if mode == "LA":
        converted.putalpha(77)
    converted.save(tmp_path / "a.png")
    expected = np.asarray(converted.convert("RGBA"))[:, :, :3]
    np.testing.assert_array_equal(load_image(tmp_path / "a.png").pixels, expected)


def raw_file(order: str, tag: int, value: int) -> bytes:
    """A TIFF whose tags, one of them of a thumbnail or of a DNG, are at the end."""
    start, at = b"II*\0" if order == "<" else b"MM\0*", 200_000
    tags = struct.pack(order + "HHHIIHHIII", 2, 256, 4, 1, 9, tag, 4, 1, value, 0)
    return start + struct.pack(order + "I", at) + bytes(at - 8) + tags


@pytest.mark.parametrize(
    ("content", "error"),
    [
        (b"", "is empty"),
        (b"hello", "is not an image of a known format"),
        (b"P2: 718.9 0 607.2 0", "is not an image of a known format"),  # KITTI's calib.txt
        (b"\0\0\0\x14ftypqt  \0\0\0\0qt  " + b"\0" * 99, "is not an image of a known format"),
        (b"\xff\xd8\xff", "is corrupt: Pillow does not read it"),
        (b"II*\0\x08" + bytes(12), "is corrupt: "),
        (b"II*\0\x10\0\0\0CR\2\0" + b"\0" * 99, "is a camera's raw file, or a TIFF"),
        (raw_file("<", 254, 1), "is a camera's raw file, or a TIFF that begins with a thumbnail"),
        (
            raw_file(">", 50706, 0x0401),
            "is a camera's raw file, or a TIFF that begins with a thumbnail",
        ),
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
    for source, words in (
        (tmp_path / "gone.png", r"gone\.png cannot be read: No such file"),
        ("x" * 5000, "cannot be read"),
        (tmp_path, "is a folder"),
        (tmp_path / "pipe", "is not a regular file"),
        (f"{tmp_path}/a\0b", "is not a regular file"),
        (tmp_path / "large.png", r"large\.png is too large"),
        (tmp_path / "phone.ppm", r"phone\.ppm cannot be decoded: OpenCV does not read"),
    ):
        with pytest.raises(ImageError, match=words):
            load_image(source)
    assert image_size(tmp_path / "phone.ppm") == (16384, 12288)


def test_heic_has_its_rotation_decoded_and_becomes_rgb(tmp_path: Path, rgb: np.ndarray) -> None:
    """An orientation becomes HEIF's own rotation, as in the files of telephones."""
    pillow_heif = pytest.importorskip("pillow_heif")
    pillow_heif.register_heif_opener()
    path, stored = tmp_path / "photo.heic", PIL.Image.fromarray(rgb)
    stored.getexif()[0x0112] = 6
    stored.save(path, "HEIF", quality=-1, chroma=444, exif=stored.getexif().tobytes())
    expected = np.asarray(PIL.ImageOps.exif_transpose(stored))
    image = load_image(path)
    assert image.exif.orientation == 1
    assert image_size(path) == image.size == expected.shape[1::-1]
    assert np.abs(image.pixels.astype(int) - expected).mean() < 3
    grey = np.repeat(rgb[:, :, :1], 3, axis=2)
    for mode, values in (("L", grey[:, :, 0]), ("RGB;16", grey.astype(np.uint16) * 257)):
        pillow_heif.from_bytes(mode, (70, 50), values.tobytes()).save(path, quality=-1, chroma=444)
        assert np.abs(load_image(path).pixels.astype(int) - grey).mean() < 3
    path.write_bytes(path.read_bytes()[:-500])
    with pytest.raises(ImageError, match=r"photo\.heic .*end of file"):
        load_image(path)


@pytest.mark.parametrize("format", ["JPEG", "PNG", "WEBP", "TIFF", "HEIF"])
def test_every_format_gives_its_block_from_the_header_and_the_file(
    tmp_path: Path, format: str
) -> None:
    """More than the first bytes must be read: WebP and TIFF have it last."""
    if format == "HEIF":
        pytest.importorskip("pillow_heif").register_heif_opener()
    path = tmp_path / "photo"
    lossless = {"lossless": True} if format == "WEBP" else {"quality": 100}
    PIL.Image.fromarray(NOISE).save(path, format, exif=block_of(TAGS), **lossless)
    assert path.stat().st_size > 2**17
    assert image_header(path).exif == load_image(path).exif == KNOWN


@pytest.mark.parametrize("kind", ["eXIf behind", "eXIf", "tEXt", "damaged"])
def test_a_png_gives_its_block_wherever_it_is(tmp_path: Path, kind: str) -> None:
    """As a chunk, and as a text that ImageMagick writes."""
    path, block = save(tmp_path / "photo.png", NOISE), block_of(TAGS)
    lines = [block.hex()[i : i + 72] for i in range(0, 2 * len(block), 72)]
    text = "\n".join(["", "exif", f"{len(block):8}", *lines, ""]).encode("ascii")
    name = b"Raw profile type exif\0"
    chunk, content = {
        "tEXt": (b"tEXt", name + text),
        "damaged": (b"tEXt", name + b"\nexif\n      8\nno digits"),
    }.get(kind, (b"eXIf", block.removeprefix(b"Exif\0\0")))
    path.write_bytes(with_chunk(path.read_bytes(), chunk, content, behind=kind == "eXIf behind"))
    expected = Exif() if kind == "damaged" else KNOWN
    assert image_header(path).exif == load_image(path).exif == expected


@pytest.mark.parametrize(
    ("tag", "values", "field"),
    [
        (FOCAL, [IFDRational(0, 1), IFDRational(1, 0), "5.1", float("nan"), (5, 5)], "focal_mm"),
        (WIDTH, [0, -1, "4032", (1, 2), 0.5], "size"),
        (PLANE_UNIT, [1, 0, 6, "cm"], "pixels_per_mm"),
        (PLANE_X, [0, IFDRational(1, 0), "many", IFDRational(5000, 1)], "pixels_per_mm"),
    ],
)
def test_what_is_no_positive_number_is_not_known(
    tmp_path: Path, tag: int, values: list[Any], field: str
) -> None:
    """The last resolution along x is half of that along y: the pixels are not square. Names are in
    one line."""
    for value in values:
        exif = exif_of(tmp_path, block_of(TAGS | {tag: value}, "a\nb" + "c" * 500))
        assert getattr(exif, field) is None, value
        assert exif.make.startswith("a bccc") and len(exif.make) == 80
    for unit, per_mm in ((2, 10000 / 25.4), (4, 10000), (5, 1e7)):
        exif = exif_of(tmp_path, block_of(TAGS | {PLANE_UNIT: unit}))
        assert exif.pixels_per_mm == pytest.approx(per_mm)


def test_a_position_has_the_letters_of_its_hemispheres(tmp_path: Path) -> None:
    south_east = (-33.5, 70.25, 12.0)
    for letters, position in (("SE", south_east), ("S", None), ("WS", None)):
        exif = PIL.Image.Exif()
        exif[271] = "Maker"  # Pillow writes no block of GPS alone
        tags = {2: (33.0, 30.0, 0.0), 4: (70.0, 15.0, 0.0), 6: 12.0}
        exif.get_ifd(34853).update(tags | dict(zip((1, 3), letters, strict=False)))
        assert exif_of(tmp_path, exif.tobytes()).position == position


def with_density(path: Path, unit: int, along_x: int, along_y: int) -> None:
    """By JFIF, by a chunk of PNG, by the tags of a TIFF, or by EXIF data of an image turned by 90
    degrees."""
    if path.suffix == ".jpg":
        data = bytearray(save(path, NOISE).read_bytes())
        assert data[6:11] == b"JFIF\0"
        data[13:18] = struct.pack(">BHH", unit, along_x, along_y)
        path.write_bytes(data)
    elif path.suffix == ".png":
        content = struct.pack(">IIB", along_x, along_y, unit)
        path.write_bytes(with_chunk(save(path, NOISE).read_bytes(), b"pHYs", content))
    else:
        exif = PIL.Image.Exif()
        exif[274] = 1 if path.suffix == ".tiff" else 6
        exif[282], exif[283], exif[296] = along_x, along_y, unit
        PIL.Image.fromarray(NOISE).save(path, exif=exif)


@pytest.mark.parametrize(
    ("suffix", "unit", "along_x", "along_y", "aspect"),
    [
        ("jpg", 0, 4, 3, 4 / 3),  # ffmpeg's frames of a video of 4:3 pixels
        ("jpg", 1, 72, 96, 4 / 3),  # dots an inch: the pixel is the wider the fewer there are
        ("jpg", 0, 65535, 1, 1),
        ("png", 0, 4, 3, 4 / 3),
        ("tiff", 2, 204, 98, 98 / 204),  # a fax
        ("webp", 2, 150, 300, 0.5),
        ("jpeg", 2, 150, 300, 0.5),  # EXIF data where JFIF states nothing
    ],
)
def test_the_shape_of_a_pixel(
    tmp_path: Path, suffix: str, unit: int, along_x: int, along_y: int, aspect: float
) -> None:
    path = tmp_path / f"a.{suffix}"
    with_density(path, unit, along_x, along_y)
    for stated in (image_header(path), load_image(path)):
        assert stated.pixel_aspect == pytest.approx(aspect, rel=1e-6)


@pytest.mark.parametrize("suffix", ["jpg", "png", "behind.png", "tiff"])
def test_the_projection_by_xmp(tmp_path: Path, suffix: str) -> None:
    path = tmp_path / f"pano.{suffix}"
    for text, projection in (
        ('<a GPano:ProjectionType="Equirectangular"/>', "equirectangular"),
        ("<GPano:ProjectionType>cylindrical</GPano:ProjectionType>", "cylindrical"),
        ('<a GPano:ProjectionType="rectilinear"/>', ""),
    ):
        xmp = f"<x:xmpmeta>{text}</x:xmpmeta>".encode()
        if suffix.endswith("png"):
            data, content = save(path, NOISE).read_bytes(), b"XML:com.adobe.xmp\0\0\0\0\0" + xmp
            path.write_bytes(with_chunk(data, b"iTXt", content, behind=suffix == "behind.png"))
        else:
            tags: dict[str, Any] = {"tiffinfo": {700: xmp}} if suffix == "tiff" else {"xmp": xmp}
            PIL.Image.fromarray(NOISE).save(path, quality=100, **tags)
        assert image_header(path).projection == load_image(path).projection == projection
