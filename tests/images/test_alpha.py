"""Alpha 0, of files, arrays and tensors, is a mask."""

from pathlib import Path

import cv2
import numpy as np
import PIL.Image
import PIL.ImageOps
import pytest
import torch

from dgc_pose.errors import ImageError, InputError
from dgc_pose.images.image import load_image


def cut_out(rgb: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Alpha of 0, 1 and 255, and the pixels where it is not 0."""
    alpha = np.full(rgb.shape[:2], 255, np.uint8)
    alpha[:30, 40:], alpha[30:40, 40:] = 0, 1
    return alpha, alpha > 0


@pytest.mark.parametrize(
    ("kind", "suffix"),
    [
        *(("RGBA", suffix) for suffix in ("png", "webp", "tiff", "gif", "avif", "heic")),
        *(("LA", "png"), ("P", "png"), ("deep", "png"), ("deep", "tiff")),
    ],
)
def test_pixels_of_alpha_0_are_masked(
    tmp_path: Path, rgb: np.ndarray, kind: str, suffix: str
) -> None:
    alpha, used = cut_out(rgb)
    path, picture = tmp_path / f"cut.{suffix}", PIL.Image.fromarray(np.dstack([rgb, alpha]))
    if suffix == "heic":
        pytest.importorskip("pillow_heif").register_heif_opener()
    if kind == "deep":
        deep = np.dstack([rgb[:, :, ::-1], alpha]).astype(np.uint16) * 257
        deep[~used, :3] = 65535  # which does not count in the range
        assert cv2.imwrite(str(path), deep)
    elif kind == "P":
        index = PIL.Image.fromarray(np.where(used, rgb[:, :, 0], 7), "P")
        index.putpalette([v for n in range(256) for v in (n, n, n)])
        index.save(path, transparency=7)
        used = used & (rgb[:, :, 0] != 7)
    else:
        picture.convert(kind).save(path, **({"lossless": True} if suffix == "webp" else {}))
    image = load_image(path)
    assert image.mask is not None and image.mask.dtype == bool
    if suffix in ("png", "webp", "tiff"):  # the others keep no alpha of 1
        np.testing.assert_array_equal(image.mask, used)
    assert not image.mask[:30, 40:].any() and image.mask[40:].any()
    hidden = image.pixels[~image.mask].astype(float)
    np.testing.assert_allclose(hidden - image.pixels[image.mask].mean(0), 0, atol=1.01)


@pytest.mark.parametrize("dtype", [np.uint8, np.uint16, np.float32, bool])
def test_alpha_of_arrays_and_tensors_is_a_mask(rgb: np.ndarray, dtype: type) -> None:
    alpha, used = cut_out(rgb)
    array = np.dstack([rgb, alpha]).astype(dtype)
    for source in (array, torch.from_numpy(array.astype(dtype)).permute(2, 0, 1)):
        image = load_image(source)
        np.testing.assert_array_equal(image.mask, used)
    plain = load_image(array[:, :, :3])
    assert plain.mask is None
    if dtype == np.uint8:
        np.testing.assert_array_equal(image.pixels[used], rgb[used])
    array[:, :, 3] = 1
    opaque = load_image(array)
    assert opaque.mask is None
    np.testing.assert_array_equal(opaque.pixels, plain.pixels)
    array[:, :, 3] = 0
    with pytest.raises(InputError, match="^image1 has alpha 0 everywhere, which leaves no pixel"):
        load_image(array, "image1")


def test_what_is_under_alpha_0_does_not_count(tmp_path: Path, rgb: np.ndarray) -> None:
    """Neither in the range, nor as a number; and a file of which nothing is left is named."""
    alpha, used = cut_out(rgb)
    deep = np.dstack([rgb * 3.0, alpha])
    dirty = deep.copy()
    dirty[~used, 0], dirty[~used, 1] = np.nan, 1e9
    np.testing.assert_array_equal(load_image(dirty).pixels, load_image(deep).pixels)
    path = tmp_path / "gone.png"
    PIL.Image.fromarray(np.dstack([rgb, alpha * 0])).save(path)
    with pytest.raises(ImageError, match=r"gone\.png has alpha 0 everywhere"):
        load_image(path)
