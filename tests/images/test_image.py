"""Images from arrays and tensors: their channels, their range, and their alpha."""

from pathlib import Path
from typing import Any

import cv2
import numpy as np
import PIL.Image
import pytest
import torch

from dgc_pose.errors import ImageError, InputError
from dgc_pose.images.image import Image, load_image, resize, unmatchable


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
    low = float(rgb.min())
    high = float(rgb.max())
    np.testing.assert_allclose(stretched, (rgb - low) / (high - low) * 255, atol=0.51)
    np.testing.assert_array_equal(load_image(rgb > 99).pixels, (rgb > 99) * 255)
    assert load_image(np.full((4, 5), 700, np.uint16)).pixels.max() == 0


@pytest.mark.parametrize(("value", "share"), [(65535, 0.0), (0, 0.3), (-3.4e38, 0.5), (1e7, 0.0)])
def test_a_few_pixels_far_off_do_not_decide_of_the_range(value: float, share: float) -> None:
    """A hot pixel, and a value that stands for no data: the others keep at least a third of the
    range that they have alone, in their order."""
    coarse = np.random.default_rng(3).uniform(7000, 8020, (12, 16)).astype(np.float32)
    clean = cv2.resize(coarse, (128, 96))
    off = np.zeros(clean.shape, bool)
    off[: round(share * len(clean))] = True
    off[0, 0] = True
    dirty = np.where(off, value, clean.astype(np.float64))
    if 0 <= value <= 65535:
        dirty = dirty.astype(np.uint16)
        clean = clean.astype(np.uint16)
    alone = load_image(clean).pixels[..., 0]
    shown = load_image(dirty).pixels[..., 0]
    assert np.ptp(shown[~off].astype(int)) > 85
    slope, offset = np.polyfit(alone[~off], shown[~off], 1)
    assert slope > 1 / 3 and np.abs(slope * alone + offset - shown)[~off].max() < 2
    assert set(np.unique(shown[off])) <= ({255} if value > 9000 else {0})


def test_resize_follows_the_half_pixel_rule() -> None:
    """A ramp stays that of the half-pixel rule: shrunk, enlarged, or each along one axis."""
    height = 300
    width = 480
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


def test_channels_may_come_first(rgb: np.ndarray) -> None:
    """But where the last axis may have them too, as of an image three pixels high, an array has
    them there, and a tensor first."""
    first = np.moveaxis(rgb, 2, 0)
    tensor = torch.from_numpy(first.copy())
    for source in (first, rgb[None], tensor[None], tensor.permute(1, 2, 0), tensor / 255):
        image = load_image(source)
        np.testing.assert_array_equal(image.pixels, rgb)
        assert image.pixels.flags.c_contiguous
    assert load_image(rgb[:3]).size == (70, 3)
    assert load_image(torch.from_numpy(rgb[:3].copy())).size == (3, 70)
    coarse = load_image((tensor / 255).requires_grad_().to(torch.bfloat16)).pixels
    assert np.abs(coarse.astype(int) - rgb).max() <= 1


@pytest.mark.parametrize(
    ("source", "words"),
    [
        (None, "is not a path, an array or a tensor: None"),
        (b"\x89PNG", "is not a path, an array or a tensor: b"),
        ("http://x/y.jpg", "is not a path, an array or a tensor: 'http://x"),
        (np.zeros((5, 20, 30), np.uint8), "must have shape"),
        (np.zeros((20, 0), np.float32), "must have shape"),
        (np.array([[0, np.inf], [1, 2]]), "has values that are not finite"),
        (np.zeros((4, 4), complex), "is not an array of real numbers but ndarray of dtype "),
    ],
)
def test_an_error_about_an_image_names_the_argument(source: Any, words: str) -> None:
    with pytest.raises(InputError, match=f"^image1 {words}"):
        load_image(source, "image1")


def cut_out(rgb: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Alpha of 0, 1 and 255, and the pixels where it is not 0."""
    alpha = np.full(rgb.shape[:2], 255, np.uint8)
    alpha[:30, 40:] = 0
    alpha[30:40, 40:] = 1
    return alpha, alpha > 0


@pytest.mark.parametrize("suffix", ["png", "tiff", "webp", "heic"])
def test_pixels_of_alpha_0_are_masked(tmp_path: Path, rgb: np.ndarray, suffix: str) -> None:
    alpha, used = cut_out(rgb)
    path = tmp_path / f"cut.{suffix}"
    if suffix == "heic":
        pytest.importorskip("pillow_heif").register_heif_opener()
    if suffix == "tiff":
        deep = np.dstack([rgb[:, :, ::-1], alpha]).astype(np.uint16) * 257
        deep[~used, :3] = 65535  # which does not count in the range
        assert cv2.imwrite(str(path), deep)
    else:
        PIL.Image.fromarray(np.dstack([rgb, alpha])).save(path)
    image = load_image(path)
    assert image.mask is not None and image.mask.dtype == bool
    if suffix != "heic":  # which keeps no alpha of 1
        np.testing.assert_array_equal(image.mask, used)
    assert not image.mask[:30, 40:].any() and image.mask[40:].any()
    hidden = image.pixels[~image.mask].astype(float)
    np.testing.assert_allclose(hidden - image.pixels[image.mask].mean(0), 0, atol=1.01)
    PIL.Image.fromarray(np.dstack([rgb, 0 * alpha])).save(tmp_path / "gone.png")
    with pytest.raises(ImageError, match=r"gone\.png has alpha 0 everywhere") as caught:
        load_image(tmp_path / "gone.png")
    assert caught.value.path == tmp_path / "gone.png"


def test_alpha_of_arrays_and_tensors_is_a_mask(rgb: np.ndarray) -> None:
    """What lies under alpha 0 counts neither in the range, nor as a number."""
    alpha, used = cut_out(rgb)
    array = np.dstack([rgb, alpha]).astype(np.float32)
    for source in (array, torch.from_numpy(array).permute(2, 0, 1)):
        np.testing.assert_array_equal(load_image(source).mask, used)
    dirty = array.copy()
    dirty[~used, 0] = np.nan
    dirty[~used, 1] = 1e9
    np.testing.assert_array_equal(load_image(dirty).pixels, load_image(array).pixels)
    array[:, :, 3] = 1
    assert load_image(array).mask is None
    np.testing.assert_array_equal(load_image(array).pixels, load_image(array[:, :, :3]).pixels)
    array[:, :, 3] = 0
    with pytest.raises(InputError, match="^image1 has alpha 0 everywhere: no pixel"):
        load_image(array, "image1")


def test_a_small_or_plain_picture_cannot_be_matched() -> None:
    """Masked pixels do not count."""
    noise = np.random.default_rng(0).integers(0, 256, (40, 60, 3), np.uint8)
    assert unmatchable(Image(noise)) == ""
    assert unmatchable(Image(noise[:14])) == (
        "the picture has 60 x 14 pixels, and 15 a side are needed"
    )
    half = noise.copy()
    half[:, :30] = 77
    left = np.arange(60) < np.full((40, 1), 30)
    assert unmatchable(Image(half)) == ""
    assert unmatchable(Image(half, mask=left)) == (
        "the grey levels differ by 0.00 (standard deviation) where the picture is not masked, "
        "and 2 are needed"
    )
