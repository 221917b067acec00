"""Reading images: every kind of file and array, and every way in which one can be unusable."""

import os
import struct
from pathlib import Path
from typing import Any

import cv2
import numpy as np
import PIL.Image
import PIL.ImageOps
import pytest
import torch

from dgc_pose.errors import ImageError, InputError
from dgc_pose.images.image import (
    image_size,
    load_image,
    read_pixels,
    resize,
    size_in_file,
)

FORMATS = ("png", "tiff", "bmp", "ppm", "jpg", "webp")


def save(path: Path, pixels: np.ndarray, orientation: int | None = None) -> Path:
    """Saves with Pillow, an independent writer."""
    image = PIL.Image.fromarray(pixels)
    exif = image.getexif()
    if orientation is not None:
        exif[0x0112] = orientation
    lossless = {"lossless": True} if path.suffix == ".webp" else {"quality": 95}
    image.save(path, exif=exif, **lossless)
    return path


@pytest.mark.parametrize("suffix", FORMATS)
def test_a_file_gives_its_pixels_in_rgb(tmp_path: Path, rgb: np.ndarray, suffix: str) -> None:
    path = save(tmp_path / f"picture.{suffix}", rgb)
    image = load_image(path)
    assert (image.size, image.name, image.exif.orientation) == ((70, 50), str(path), 1)
    assert image.pixels.dtype == np.uint8 and image.pixels.flags.c_contiguous
    difference = np.abs(image.pixels.astype(int) - rgb)
    assert difference.max() == 0 if suffix != "jpg" else difference.mean() < 3
    np.testing.assert_array_equal(load_image(str(path)).pixels, image.pixels)


@pytest.mark.parametrize("orientation", range(1, 9))
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
        assert load_image(image) is image
    path = save(tmp_path / "turned.tiff", rgb, orientation)
    if orientation == 1:
        assert load_image(path).size == (70, 50)
    else:
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


@pytest.mark.parametrize("mode", ["L", "LA", "RGBA", "P", "1"])
def test_grey_alpha_and_palette_files_become_rgb(
    tmp_path: Path, rgb: np.ndarray, mode: str
) -> None:
    converted = PIL.Image.fromarray(rgb).convert(mode)
    if mode in ("LA", "RGBA"):
        converted.putalpha(77)
    path = tmp_path / f"{mode}.png"
    converted.save(path)
    expected = np.asarray(converted.convert("RGBA"))[:, :, :3]
    np.testing.assert_array_equal(load_image(path).pixels, expected)
    deep = np.dstack([rgb.astype(np.uint16) * 16, np.full(rgb.shape[:2], 65535, np.uint16)])
    assert cv2.imwrite(str(path), deep[:, :, [2, 1, 0, 3]])
    for source in (path, deep):  # alpha does not count in the range
        np.testing.assert_array_equal(load_image(source).pixels, load_image(deep[:, :, :3]).pixels)


@pytest.mark.parametrize("suffix", FORMATS)
def test_a_truncated_file_is_refused(tmp_path: Path, rgb: np.ndarray, suffix: str) -> None:
    path = save(tmp_path / f"short.{suffix}", rgb)
    data = path.read_bytes()
    for share in (0.02, 0.5, 0.95):
        path.write_bytes(data[: max(2, int(len(data) * share))])
        with pytest.raises(ImageError, match=r"short\."):
            load_image(path)


@pytest.mark.parametrize(
    ("content", "error"),
    [
        (b"hello", "is not an image of a known format"),
        (b"P2: 718.9 0 607.2 0", "is not an image of a known format"),  # KITTI's calib.txt
        (b"\0\0\0\x14ftypqt  \0\0\0\0qt  " + b"\0" * 99, "is not an image of a known format"),
        (b"\xff\xd8\xff", "is corrupt: "),
        (b"\x89PNG\r\n\x1a\n", "is corrupt: "),
        (b"II*\0\x08" + bytes(12), "is corrupt: "),
        (b"II*\0\x10\0\0\0CR\2\0" + b"\0" * 99, "is a camera's raw file, or begins with a"),
    ],
)
def test_a_file_that_cannot_be_read(tmp_path: Path, content: bytes, error: str) -> None:
    path = tmp_path / "photo.jpg"
    path.write_bytes(content)
    for read in (load_image, image_size):
        with pytest.raises(ImageError) as caught:
            read(path)
        assert str(caught.value).startswith(f"{path} {error}")


@pytest.mark.parametrize("tag", [(254, 1), (50706, 0x0401)], ids=["thumbnail", "DNG"])
@pytest.mark.parametrize("order", "<>")
@pytest.mark.parametrize("tags_at", [8, 5000, 200_000])  # as other programs put them: at the end
def test_a_raw_file_is_no_photograph_of_the_size_of_its_thumbnail(
    tmp_path: Path, tag: tuple[int, int], order: str, tags_at: int
) -> None:
    path = tmp_path / "raw.nef"
    start = b"II*\0" if order == "<" else b"MM\0*"
    tags = struct.pack(order + "HHHIIHHIII", 2, 256, 4, 1, 9, tag[0], 4, 1, tag[1], 0)
    path.write_bytes(start + struct.pack(order + "I", tags_at) + bytes(tags_at - 8) + tags)
    for read in (load_image, image_size):
        with pytest.raises(ImageError, match="raw file, or begins with a thumbnail"):
            read(path)


@pytest.mark.parametrize("orientation", [1, 2, 6, 7])
def test_the_rotation_of_heic_is_part_of_decoding(
    tmp_path: Path, rgb: np.ndarray, orientation: int
) -> None:
    """An orientation becomes HEIF's own rotation, as in the files of telephones."""
    pytest.importorskip("pillow_heif").register_heif_opener()
    path, stored = tmp_path / "photo.heic", PIL.Image.fromarray(rgb)
    stored.getexif()[0x0112] = orientation
    stored.save(path, "HEIF", quality=-1, chroma=444, exif=stored.getexif().tobytes())
    expected = np.asarray(PIL.ImageOps.exif_transpose(stored))
    image = load_image(path)
    assert image.exif.orientation == 1
    assert image_size(path) == image.size == expected.shape[1::-1]
    assert np.abs(image.pixels.astype(int) - expected).mean() < 3
    assert np.abs(read_pixels(path)[:, :, ::-1].astype(int) - expected).mean() < 3


def test_heic_of_other_values_becomes_rgb(tmp_path: Path, rgb: np.ndarray) -> None:
    pillow_heif = pytest.importorskip("pillow_heif")
    grey = np.repeat(rgb[:, :, :1], 3, axis=2)
    path = tmp_path / "photo.heic"
    for mode, values in (
        ("L", grey[:, :, 0]),
        ("RGBA", np.dstack([grey, grey[:, :, 0]])),
        ("RGB;16", grey.astype(np.uint16) * 257),
    ):
        pillow_heif.from_bytes(mode, (70, 50), values.tobytes()).save(path, quality=-1, chroma=444)
        assert np.abs(load_image(path).pixels.astype(int) - grey).mean() < 3
    path.write_bytes(path.read_bytes()[:-500])
    with pytest.raises(ImageError, match=r"photo\.heic .*end of file"):
        load_image(path)


def test_missing_empty_folder_and_too_large(tmp_path: Path) -> None:
    with pytest.raises(ImageError, match=r"gone\.png cannot be read: No such file"):
        load_image(tmp_path / "gone.png")
    (tmp_path / "empty.png").touch()
    with pytest.raises(ImageError, match=r"empty\.png is empty"):
        load_image(tmp_path / "empty.png")
    with pytest.raises(ImageError, match="is a folder, and only regular files are read"):
        load_image(tmp_path)
    with pytest.raises(ImageError, match="cannot be read"):
        load_image("x" * 5000)
    os.truncate(tmp_path / "empty.png", 2**31)
    with pytest.raises(ImageError, match=r"empty\.png is too large"):
        load_image(tmp_path / "empty.png")


def test_a_huge_image_is_refused_by_its_header(tmp_path: Path) -> None:
    path = tmp_path / "huge.ppm"
    path.write_bytes(b"P6\n60000 50000\n255\n" + bytes(100))
    with pytest.raises(ImageError, match=r"huge\.ppm is too large: 60000 x 50000"):
        load_image(path)
    # From a telephone, beyond Pillow's limit.
    path.write_bytes(b"P6\n16384 12288\n255\n" + bytes(100))
    assert image_size(path) == (16384, 12288)
    with pytest.raises(ImageError, match=r"huge\.ppm cannot be decoded: OpenCV does not read"):
        load_image(path)


def test_arrays_of_8_bits_are_kept(rgb: np.ndarray) -> None:
    image = load_image(rgb[::-1, ::-1], "image1")
    np.testing.assert_array_equal(image.pixels, np.flip(rgb, (0, 1)))
    assert image.pixels.flags.c_contiguous
    assert image.name == "image1" and image.size == (70, 50)
    grey = rgb[:, :, 0]
    repeated = np.dstack([grey] * 3)
    for array in (grey, grey[:, :, None], repeated, np.dstack([repeated, rgb[:, :, 1]])):
        np.testing.assert_array_equal(load_image(array).pixels, repeated)


def test_floats_within_0_and_1_are_multiplied_and_others_stretched(rgb: np.ndarray) -> None:
    half = rgb.astype(np.float32) / 510
    np.testing.assert_allclose(load_image(half).pixels, rgb / 2, atol=0.51)
    stretched = load_image(rgb.astype(np.float64) * 7 - 300).pixels
    low, high = float(rgb.min()), float(rgb.max())
    np.testing.assert_allclose(stretched, (rgb - low) / (high - low) * 255, atol=0.51)
    np.testing.assert_array_equal(load_image(rgb > 99).pixels, (rgb > 99) * 255)
    assert load_image(np.full((4, 5), 700, np.uint16)).pixels.max() == 0


def thermal(shape: tuple[int, int] = (96, 128)) -> np.ndarray:
    """Smooth, of 7000 to 8020."""
    coarse = np.random.default_rng(3).uniform(7000, 8020, (12, 16)).astype(np.float32)
    return cv2.resize(coarse, shape[::-1])


@pytest.mark.parametrize(
    ("value", "share"),
    [(65535, 0.0), (30000, 0.004), (0, 0.0), (0, 0.3), (-9999, 0.2), (-3.4e38, 0.5), (1e7, 0.0)],
)
def test_a_few_pixels_far_off_do_not_decide_of_the_range(value: float, share: float) -> None:
    """Hot pixels, one and some, and a value that stands for no data: the others keep at least a
    third of the range that they have alone, in their order."""
    clean = thermal()
    dirty = clean.astype(np.float64)
    off = np.zeros(dirty.shape, bool)
    off[: round(share * len(dirty))] = True
    if share < 0.01:
        off.flat[:: round(1 / share) if share else dirty.size] = True
    dirty[off] = value
    if 0 <= value <= 65535:
        dirty, clean = dirty.astype(np.uint16), clean.astype(np.uint16)
    alone, shown = load_image(clean).pixels[..., 0], load_image(dirty).pixels[..., 0]
    assert np.ptp(shown[~off].astype(int)) > 85
    slope, offset = np.polyfit(alone[~off], shown[~off], 1)
    assert slope > 1 / 3 and np.abs(slope * alone + offset - shown)[~off].max() < 2
    assert set(np.unique(shown[off])) <= ({255} if value > 9000 else {0})


def test_resize_follows_the_half_pixel_rule() -> None:
    """A ramp stays that of the half-pixel rule: shrunk, enlarged, or each along one axis."""
    height, width = 300, 480
    x = np.arange(width) * 0.5
    ramp = np.repeat(np.repeat(x[None, :, None], height, 0), 3, 2)
    for size in ((240, 240), (960, 600), (240, 600), (960, 100)):
        resized = resize(ramp.astype(np.float32), size)
        assert resized.shape == (size[1], size[0], 3)
        expected = ((np.arange(size[0]) + 0.5) * width / size[0] - 0.5) * 0.5
        inner = slice(4, -4)
        np.testing.assert_allclose(resized[5, inner, 0], expected[inner], atol=1e-3)
    for side, factor in ((960, 4), (2400, 10)):  # the larger one is halved first
        noise = np.random.default_rng(0).integers(0, 256, (side, side, 3), dtype=np.uint8)
        averages = noise.reshape(240, factor, 240, factor, 3).mean((1, 3))
        assert np.abs(resize(noise, (240, 240)) - averages).max() <= 1


@pytest.mark.parametrize("channels", [1, 3, 4])
def test_channels_may_come_first(rgb: np.ndarray, channels: int) -> None:
    """But where the last axis may have them too, as of an image three pixels high, an array has
    them there, and a tensor first."""
    last = np.dstack([rgb, rgb[:, :, :1] | 1])[:, :, :channels]
    expected, first = load_image(last), np.moveaxis(last, 2, 0)
    tensor = torch.from_numpy(first.copy())
    for source in (first, last[None], first[None], tensor, tensor[None], tensor.permute(1, 2, 0)):
        image = load_image(source)
        np.testing.assert_array_equal(image.pixels, expected.pixels)
        assert image.pixels.flags.c_contiguous
    assert load_image(last[:3]).size == (70, 3)
    assert load_image(torch.from_numpy(last[:3].copy())).size == (channels, 70)
    floats = (tensor / 255).requires_grad_()
    np.testing.assert_array_equal(load_image(floats).pixels, expected.pixels)
    coarse = load_image(floats.detach().to(torch.bfloat16)).pixels
    assert np.abs(coarse.astype(int) - expected.pixels).max() <= 1


@pytest.mark.parametrize(
    ("source", "words"),
    [
        (None, "is no path, no array and no tensor: None"),
        (b"\x89PNG", "is no path, no array and no tensor: b"),
        ("http://x/y.jpg", "is no path, no array and no tensor: 'http://x"),
        (np.zeros((5, 20, 30), np.uint8), "must have shape"),
        (np.zeros((20, 0), np.float32), "must have shape"),
        (np.array([[0, np.inf], [1, 2]]), "has values that are not finite"),
        (np.zeros((4, 4), complex), "is not an array of real numbers"),
    ],
)
def test_what_is_no_image_names_the_argument(source: Any, words: str) -> None:
    with pytest.raises(InputError, match=f"^image1 {words}"):
        load_image(source, "image1")
