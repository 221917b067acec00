"""What a header says beside its EXIF data: the shape of a pixel, and a panorama's projection."""

import struct
from pathlib import Path

import numpy as np
import PIL.Image
import PIL.PngImagePlugin
import pytest
from png_chunks import with_chunk

from dgc_pose.images.image import image_header, load_image

NOISE = np.random.default_rng(0).integers(0, 256, (24, 32, 3), np.uint8)
LARGE = np.random.default_rng(0).integers(0, 256, (300, 400, 3), np.uint8)  # over 2**17 bytes


def saved(path: Path, pixels: np.ndarray = NOISE, **options: object) -> bytes:
    PIL.Image.fromarray(pixels).save(path, **options)  # type: ignore[arg-type]
    return path.read_bytes()


def jfif(path: Path, unit: int, along_x: int, along_y: int) -> None:
    data = bytearray(saved(path))
    assert data[6:11] == b"JFIF\0"
    data[13:18] = struct.pack(">BHH", unit, along_x, along_y)
    path.write_bytes(data)


def phys(path: Path, unit: int, along_x: int, along_y: int) -> None:
    content = struct.pack(">IIB", along_x, along_y, unit)
    path.write_bytes(with_chunk(saved(path), b"pHYs", content))


def resolutions(path: Path, unit: int, along_x: int, along_y: int) -> None:
    """Of EXIF, and of a TIFF as its tags."""
    exif = PIL.Image.Exif()
    exif[282], exif[283], exif[296] = along_x, along_y, unit
    saved(path, exif=exif)


WRITERS = {"jpg": jfif, "png": phys, "tiff": resolutions, "webp": resolutions, "jpeg": resolutions}


@pytest.mark.parametrize(
    ("suffix", "unit", "along_x", "along_y", "aspect"),
    [
        ("jpg", 0, 4, 3, 4 / 3),  # ffmpeg's frames of a video of 4:3 pixels
        ("jpg", 0, 1, 1, 1),
        ("jpg", 1, 72, 96, 4 / 3),  # dots an inch: the pixel is the wider the fewer there are
        ("jpg", 0, 0, 3, 1),
        ("jpg", 0, 65535, 1, 1),
        ("png", 0, 4, 3, 4 / 3),  # ffmpeg's too
        ("png", 1, 3000, 4000, 4 / 3),
        ("png", 1, 100, 401, 1),
        ("tiff", 1, 3, 4, 4 / 3),
        ("tiff", 2, 204, 98, 98 / 204),  # a fax
        ("webp", 2, 150, 300, 2),
        ("jpeg", 2, 150, 300, 2),  # EXIF data where JFIF states nothing
    ],
)
def test_the_shape_of_a_pixel(
    tmp_path: Path, suffix: str, unit: int, along_x: int, along_y: int, aspect: float
) -> None:
    path = tmp_path / f"a.{suffix}"
    WRITERS[suffix](path, unit, along_x, along_y)
    for stated in (image_header(path), load_image(path)):
        assert stated.pixel_aspect == pytest.approx(aspect, rel=1e-6)


@pytest.mark.parametrize("orientation", range(1, 9))
def test_a_pixel_is_turned_with_its_image(tmp_path: Path, orientation: int) -> None:
    exif = PIL.Image.Exif()
    exif[274], exif[282], exif[283], exif[296] = orientation, 80, 100, 2
    saved(tmp_path / "a.webp", exif=exif)
    for stated in (image_header(tmp_path / "a.webp"), load_image(tmp_path / "a.webp")):
        assert stated.pixel_aspect == (1.25 if orientation < 5 else 0.8)


ATTRIBUTE = '<x:xmpmeta><rdf:Description GPano:ProjectionType="{}"/></x:xmpmeta>'
ELEMENT = "<x:xmpmeta><GPano:ProjectionType>{}</GPano:ProjectionType></x:xmpmeta>"


@pytest.mark.parametrize("suffix", ["jpg", "png", "behind.png", "webp", "tiff"])
@pytest.mark.parametrize("pixels", [NOISE, LARGE], ids=["small", "large"])
@pytest.mark.parametrize(
    ("xmp", "projection"),
    [
        (ATTRIBUTE.format("Equirectangular"), "equirectangular"),
        (ELEMENT.format("cylindrical"), "cylindrical"),
        (ATTRIBUTE.format("rectilinear"), ""),
        ("<x:xmpmeta>GPano equirectangular</x:xmpmeta>", ""),
    ],
)
def test_the_projection_by_xmp(
    tmp_path: Path, suffix: str, pixels: np.ndarray, xmp: str, projection: str
) -> None:
    path = tmp_path / f"pano.{suffix}"
    if suffix.endswith("png"):
        content = b"XML:com.adobe.xmp\0\0\0\0\0" + xmp.encode()
        behind = suffix == "behind.png"
        path.write_bytes(with_chunk(saved(path, pixels), b"iTXt", content, behind=behind))
    elif suffix == "tiff":
        saved(path, pixels, tiffinfo={700: xmp.encode()})
    else:
        saved(path, pixels, xmp=xmp.encode(), quality=100)
    assert image_header(path).projection == load_image(path).projection == projection
