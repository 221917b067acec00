"""Masks of images: which pixels are matched."""

from __future__ import annotations

import os
from dataclasses import replace
from pathlib import Path
from typing import TYPE_CHECKING

import cv2
import numpy as np
from numpy.typing import ArrayLike

from dgc_pose.errors import ArgumentName, InputError
from dgc_pose.files.arrays import as_numpy
from dgc_pose.geometry.pixels import Size
from dgc_pose.images.image import Image, filled, load_image, read_pixels, turned
from dgc_pose.system.threads import in_threads

if TYPE_CHECKING:
    import torch

    ImageSource = str | Path | np.ndarray | torch.Tensor | Image
    MaskSource = str | Path | ArrayLike | None

_SAME_SHAPE = 0.01  # relative difference of the aspect ratios up to which a mask is scaled


def masked(image: Image, source: str | Path | ArrayLike | None, name: str = "") -> Image:
    """The image with a mask of its pixels as stored, which is turned with them; without one, None,
    the image as it is.

    source: a path, or an array (H, W), or (H, W, C) of colours, of which the second or fourth is
    alpha. Pixels that are 0, False, black or of alpha 0 are not matched, nor are those that the
    image's own mask leaves out; they get the mean colour of the others. A mask of another size is
    scaled to that of the image. name: of the argument in errors, which have the path without it.

    Raises ImageError, with the path, if a file cannot be read; InputError, with `name`, if an array
    has another shape, if the mask has another aspect ratio than the image, and if it leaves no
    pixel of it.
    """
    if source is None:
        return image
    argument = ArgumentName(name or source)
    array = read_pixels(source) if isinstance(source, str | Path) else as_numpy(source, name)
    if array.ndim not in (2, 3) or array.size == 0:
        raise InputError(argument, f"must have shape (H, W), not {array.shape}")
    array = array[:, :, None] if array.ndim == 2 else array
    colours = 2 * ((array.shape[2] - 1) // 2) + 1  # 1 of 2 and 3 of 4, the last being alpha
    used = (array[:, :, :colours] != 0).any(2) & (array[:, :, colours:] != 0).all(2)
    used = turned(used, image.exif.orientation)
    (height, width), (columns, rows) = used.shape, image.size
    if abs(width * rows / (height * columns) - 1) > _SAME_SHAPE:
        raise InputError(argument, f"is {width} x {height} and the image {columns} x {rows}")
    if (width, height) != image.size:
        used = resized_mask(used, image.size)
    used &= True if image.mask is None else image.mask
    if not used.any():
        raise InputError(argument, "leaves no pixel of the image")
    return replace(image, pixels=filled(image.pixels, used), mask=used)


def load_pair(
    images: tuple[ImageSource, ImageSource], masks: tuple[MaskSource, MaskSource] = (None, None)
) -> tuple[Image, Image]:
    """Both images with their masks. Raises as `load_image` and `masked`, naming image1 to mask2."""

    def load(number: int) -> Image:
        image = load_image(images[number], f"image{number + 1}")
        return masked(image, masks[number], f"mask{number + 1}")

    first, second = in_threads(load, (0, 1))
    return first, second


def resized_mask(mask: np.ndarray, size: Size) -> np.ndarray:
    """A mask (H, W), bool, at a size (width, height): the nearest pixels by the half-pixel rule."""
    nearest = cv2.INTER_NEAREST_EXACT
    return cv2.resize(mask.astype(np.uint8), size, interpolation=nearest).astype(bool)


def mask_file(folder: str | Path | None, name: str) -> Path | None:
    """The mask of the image `name` in a folder of masks, by COLMAP's convention `name`.png; None
    if it has none."""
    path = None if folder is None else Path(f"{folder}/{name}.png")
    return path if path and os.path.lexists(path) else None
