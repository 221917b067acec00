"""EXIF blocks: written by Pillow in every format, damaged, and absurd."""

import io
import zlib
from pathlib import Path
from typing import Any

import numpy as np
import PIL.Image
import pytest
from PIL.TiffImagePlugin import IFDRational
from png_chunks import with_chunk

from dgc_pose.images.header import Exif, read_exif
from dgc_pose.images.image import image_header, load_image

pytestmark = pytest.mark.filterwarnings("ignore")  # of Pillow, about damaged blocks

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


def block_of(tags: dict[int, Any], make: str = "Apple", model: str = "iPhone 13") -> bytes:
    exif = PIL.Image.Exif()
    exif[271], exif[272] = make, model
    exif.get_ifd(0x8769).update(tags)
    return exif.tobytes()


def exif_of(block: bytes) -> Exif:
    return read_exif(io.BytesIO(block.removeprefix(b"Exif\0\0")))[0]


@pytest.mark.parametrize("format", ["JPEG", "PNG", "WEBP", "TIFF", "HEIF"])
@pytest.mark.parametrize("side", [16, 400])
def test_every_format_gives_its_block_from_the_header_and_the_file(
    tmp_path: Path, format: str, side: int
) -> None:
    """Of the larger images more than the first bytes must be read: WebP and TIFF have it last."""
    if format == "HEIF":
        pytest.importorskip("pillow_heif").register_heif_opener()
    path = tmp_path / "photo"
    noise = np.random.default_rng(0).integers(0, 256, (side, side, 3), np.uint8)
    lossless = {"lossless": True} if format == "WEBP" else {"quality": 100}
    PIL.Image.fromarray(noise).save(path, format, exif=block_of(TAGS), **lossless)
    assert side < 400 or path.stat().st_size > 2**17
    assert image_header(path).exif == load_image(path).exif == KNOWN


@pytest.mark.parametrize("kind", ["eXIf behind", "eXIf", "tEXt", "zTXt", "damaged"])
@pytest.mark.parametrize("side", [16, 400])
def test_a_png_gives_its_block_wherever_it_is(tmp_path: Path, kind: str, side: int) -> None:
    """As a chunk, and as a text that ImageMagick writes."""
    path, block = tmp_path / "photo.png", block_of(TAGS)
    noise = np.random.default_rng(0).integers(0, 256, (side, side, 3), np.uint8)
    PIL.Image.fromarray(noise).save(path)
    lines = [block.hex()[i : i + 72] for i in range(0, 2 * len(block), 72)]
    text = "\n".join(["", "exif", f"{len(block):8}", *lines, ""]).encode("ascii")
    name = b"Raw profile type exif\0"
    chunk, content = {
        "tEXt": (b"tEXt", name + text),
        "zTXt": (b"zTXt", name + b"\0" + zlib.compress(text)),
        "damaged": (b"tEXt", name + b"\nexif\n      8\nno digits"),
    }.get(kind, (b"eXIf", block.removeprefix(b"Exif\0\0")))
    data = with_chunk(path.read_bytes(), chunk, content, behind=kind == "eXIf behind")
    path.write_bytes(data)
    expected = Exif() if kind == "damaged" else KNOWN
    assert image_header(path).exif == load_image(path).exif == expected


def test_a_tiff_without_a_directory_of_exif_may_name_its_camera(tmp_path: Path) -> None:
    PIL.Image.new("L", (8, 8)).save(tmp_path / "a.tiff", tiffinfo={271: "Canon", 272: "EOS"})
    assert load_image(tmp_path / "a.tiff").exif == Exif(make="Canon", model="EOS")
    PIL.Image.new("L", (8, 8)).save(tmp_path / "b.tiff")
    assert load_image(tmp_path / "b.tiff").exif == exif_of(b"") == Exif()


@pytest.mark.parametrize(
    ("tag", "values", "field"),
    [
        (FOCAL, [0, IFDRational(0, 1), IFDRational(1, 0), IFDRational(0, 0), "5.1"], "focal_mm"),
        (FOCAL, [IFDRational(-5, 1), float("nan"), float("inf"), (5.1, 5.1), b"5"], "focal_mm"),
        (ZOOM, [0, IFDRational(0, 1), IFDRational(1, 2), 1000, "2", (2, 2)], "digital_zoom"),
        (FILM, [0, -26, "26 mm", (26, 26)], "focal_35mm"),
        (WIDTH, [0, -1, "4032", (1, 2), 0.5], "size"),
        (PLANE_UNIT, [1, 0, 6, "cm"], "pixels_per_mm"),
        (PLANE_X, [0, IFDRational(1, 0), "many", IFDRational(5000, 1)], "pixels_per_mm"),
    ],
)
def test_what_is_no_positive_number_is_not_known(tag: int, values: list[Any], field: str) -> None:
    """The last resolution along x is half of that along y: the pixels are not square."""
    for value in values:
        exif = exif_of(block_of(TAGS | {tag: value}))
        assert getattr(exif, field) == (1 if tag == ZOOM else None), value
        assert exif.model == "iPhone 13"


def test_units_of_the_resolution_and_names_in_one_line() -> None:
    for unit, per_mm in ((2, 10000 / 25.4), (3, 1000), (4, 10000), (5, 1e7)):
        exif = exif_of(block_of(TAGS | {PLANE_UNIT: unit}))
        assert exif.pixels_per_mm == pytest.approx(per_mm)
    without = {tag: value for tag, value in TAGS.items() if tag != PLANE_UNIT}
    exif = exif_of(block_of(without, "OLYMPUS\0\0  ", "a\nb" + "c" * 500))
    assert exif.pixels_per_mm == pytest.approx(10000 / 25.4)
    assert exif.make == "OLYMPUS"
    assert exif.model.startswith("a bccc") and len(exif.model) == 80


@pytest.mark.parametrize(
    ("letters", "position"),
    [
        ({1: "S", 3: "E"}, (-33.5, 70.25, 12.0)),
        ({1: "N", 3: "W"}, (33.5, -70.25, 12.0)),
        ({}, None),
        ({1: "S"}, None),
        ({1: "S", 3: ""}, None),
        ({1: "W", 3: "S"}, None),
    ],
)
def test_a_position_has_the_letters_of_its_hemispheres(
    letters: dict[int, str], position: tuple[float, float, float] | None
) -> None:
    exif = PIL.Image.Exif()
    exif[271] = "Maker"  # Pillow writes no block of GPS alone
    exif.get_ifd(34853).update({2: (33.0, 30.0, 0.0), 4: (70.0, 15.0, 0.0), 6: 12.0, **letters})
    assert exif_of(exif.tobytes()).position == position
