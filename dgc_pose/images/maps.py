"""What belongs to the pixels of an image: masks, which say what is matched, and depth maps."""

from __future__ import annotations

import os
from dataclasses import replace
from pathlib import Path
from typing import TYPE_CHECKING

import cv2
import numpy as np
from numpy.typing import ArrayLike

from dgc_pose.errors import ArgumentName, InputError
from dgc_pose.geometry.pixels import Size
from dgc_pose.images.decoding import read_pixels
from dgc_pose.images.image import Image, filled, load_image, turned
from dgc_pose.system.arrays import as_numpy, read_array, read_arrays
from dgc_pose.system.parallel import in_threads

if TYPE_CHECKING:
    import torch

    ImageSource = str | Path | np.ndarray | torch.Tensor | Image
    MaskSource = str | Path | ArrayLike | None

_SAME_SHAPE = 0.01  # relative difference of the aspect ratios up to which a map is scaled
_WINDOW = 3, 3  # pixels of a depth map
_STRADDLES = 0.05  # depths there that differ by a larger share lie on several surfaces


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


def read_depth(
    source: str | Path | np.ndarray | None, name: str, size: Size, orientation: int
) -> np.ndarray | None:
    """1 / depth (H, W), 1 / metres, at the pixels of a photograph of `size`, NaN where not known.

    source: the depth map, of any size, or its .npy, .npz of one array, PNG or TIFF; None of None.
    Integers are millimetres, floats metres; what is not finite and above 0 is not known, and edges
    are not. orientation: by EXIF, of the map, which the photograph has had applied. Raises
    InputError, naming the argument `name`; for a damaged file InputError or ImageError, with the
    path.
    """
    if source is None:
        return None
    stored = source if isinstance(source, np.ndarray) else _read(Path(source))
    shape = f"has shape {stored.shape} and type {stored.dtype}"
    if stored.ndim != 2 or stored.dtype.kind not in "uif" or stored.dtype.itemsize < 2:
        raise InputError(ArgumentName(name), f"{shape}, not (H, W) of floats or 16-bit integers")
    depth = turned(stored, orientation) * np.float32(1 if stored.dtype.kind == "f" else 1e-3)
    known = np.isfinite(depth) & (depth > 0)
    if not known.any():
        raise InputError(ArgumentName(name), f"{shape}, and no depth above 0")
    if abs(depth.shape[1] * size[1] / (depth.shape[0] * size[0]) - 1) > _SAME_SHAPE:
        aspect = f"another aspect ratio than the {size[0]} x {size[1]} pixels of the photograph"
        raise InputError(ArgumentName(name), f"{shape}, {aspect}")
    inverse = np.divide(1, depth, out=np.zeros(depth.shape, np.float32), where=known)
    least = cv2.erode(np.where(known, inverse, np.float32(np.inf)), np.ones(_WINDOW))
    is_surface = cv2.dilate(inverse, np.ones(_WINDOW)) / (1 + _STRADDLES) <= least
    with np.errstate(invalid="ignore"):  # where nothing is known
        mean = cv2.blur(inverse, _WINDOW) / cv2.blur(known.astype(np.float32), _WINDOW)
    # Linear in the inverse depth, which is exact on planes; by the half-pixel rule.
    return cv2.resize(np.where(is_surface, mean, np.float32(np.nan)), size)


def _read(path: Path) -> np.ndarray:
    if path.suffix.lower() not in (".npy", ".npz"):
        return read_pixels(path)
    arrays = read_arrays(path) if path.suffix.lower() == ".npz" else {"": read_array(path)}
    if len(arrays) != 1:
        raise InputError(path, f"holds {len(arrays)} arrays, and a depth map is one")
    return next(iter(arrays.values()))
