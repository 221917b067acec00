"""Read an upright 8-bit RGB image and its mask, from a file or from memory."""

from __future__ import annotations

import base64
import os
from dataclasses import dataclass, replace
from pathlib import Path
from typing import TYPE_CHECKING, Literal

import cv2
import numpy as np
from numpy.typing import ArrayLike

from dgc_pose.errors import ArgumentName, ImageError, InputError
from dgc_pose.geometry.pixels import EXCHANGING, Size, within
from dgc_pose.images.decoding import Exif, Header, decoded, image_errors, read_pixels
from dgc_pose.system.arrays import as_numpy, is_tensor
from dgc_pose.system.parallel import in_threads

if TYPE_CHECKING:
    import torch

SAME_SHAPE = 0.01  # largest relative difference in aspect ratio between a mask or map and its image
_LEAST_SIDE = 15  # pixels, of a patch that is aligned: a smaller image has none
_LEAST_CONTRAST = 2.0  # standard deviation of grey levels; one colour or a covered lens has less
_SAMPLED_SIDE = 256  # pixels of the shorter side whose contrast is measured, at least
_LARGE = 4_000_000  # pixels; above, area means take tens of ms unless the sides are halved


@dataclass(frozen=True, eq=False)
class Image:
    """An image of 8-bit RGB. Raises InputError for pixels of another type or shape.

    Attributes:
        pixels: Colours (H, W, 3) uint8, RGB, contiguous.
        name: The path, or the argument's name.
        stored_size: Size (width, height) before `pixels` were resized after reading; None if not
            resized.
        exif: EXIF data of the file; its orientation has been applied to `pixels`.
        mask: (H, W) bool, False for pixels that are not matched; None to match all.
        pixel_aspect: Width of a pixel of `pixels` over its height; 1 if the file does not state it.
        projection: Projection of a panorama, from the file's XMP; "" if it states none.
    """

    pixels: np.ndarray
    name: str = "image"
    stored_size: tuple[int, int] | None = None
    exif: Exif = Exif()
    mask: np.ndarray | None = None
    pixel_aspect: float = 1.0
    projection: str = ""

    def __post_init__(self) -> None:
        pixels = self.pixels
        if not isinstance(pixels, np.ndarray) or pixels.dtype != np.uint8:
            raise InputError(f"{self.name}: pixels must be a uint8 array")
        if pixels.ndim != 3 or pixels.shape[2] != 3 or pixels.size == 0:
            raise InputError(f"{self.name}: pixels must have shape (H, W, 3), not {pixels.shape}")
        if self.mask is not None and (self.mask.dtype, self.mask.shape) != (bool, pixels.shape[:2]):
            raise InputError(f"{self.name}: mask must be a bool array {pixels.shape[:2]}")

    def __repr__(self) -> str:
        return f"Image({self.name}, {self.size[0]} x {self.size[1]})"

    @property
    def size(self) -> tuple[int, int]:
        """(width, height) in pixels."""
        return self.pixels.shape[1], self.pixels.shape[0]

    def is_masked(self, points: np.ndarray) -> np.ndarray:
        """Whether points (..., 2), pixels, lie on masked pixels: (...) bool. False outside the
        image."""
        inside = within(points, self.size)
        if self.mask is None:
            return np.zeros_like(inside)
        x, y = np.moveaxis(np.floor(np.where(inside[..., None], points, 0) + 0.5), -1, 0)
        return inside & ~self.mask[y.astype(np.intp), x.astype(np.intp)]


if TYPE_CHECKING:
    ImageSource = str | os.PathLike[str] | np.ndarray | torch.Tensor | Image
    MaskSource = str | Path | ArrayLike | None


def size_in_file(image: Image | Header) -> Size:
    """(width, height) of the pixels as stored, before the EXIF orientation is applied."""
    return image.size[::-1] if image.exif.orientation in EXCHANGING else image.size


def unmatchable(image: Image | Header) -> str:
    """Why nothing in an image can be matched: its size, or its contrast, which a header does not
    have; "" if it may be."""
    if min(image.size) < _LEAST_SIDE:
        width, height = image.size
        return f"the picture has {width} x {height} pixels, and {_LEAST_SIDE} a side are needed"
    if isinstance(image, Image) and (contrast := _contrast(image)) < _LEAST_CONTRAST:
        where = "" if image.mask is None else " where the picture is not masked"
        differ = f"the grey levels differ by {contrast:.2f} (standard deviation){where}"
        return f"{differ}, and {_LEAST_CONTRAST:g} are needed"
    return ""


def require_matchable(image: Image) -> None:
    """Raise ImageError, with the image's name, if nothing in it can be matched."""
    if why := unmatchable(image):
        raise ImageError(f"{image.name}: {why}")


def _contrast(image: Image) -> float:
    """The standard deviation of the grey levels: of a sample, or of all pixels that are not
    masked."""
    if image.mask is not None:
        return float(cv2.cvtColor(image.pixels, cv2.COLOR_RGB2GRAY)[image.mask].std())
    step = max(1, min(image.size) // _SAMPLED_SIDE)
    sample = np.ascontiguousarray(image.pixels[::step, ::step])
    return float(cv2.cvtColor(sample, cv2.COLOR_RGB2GRAY).std())


def flipped(image: Image, axis: int) -> Image:
    """The mirror image, flipped top to bottom (axis 0) or left to right (1)."""
    mask = None if image.mask is None else np.ascontiguousarray(np.flip(image.mask, axis))
    return replace(image, pixels=np.ascontiguousarray(np.flip(image.pixels, axis)), mask=mask)


def turned(pixels: np.ndarray, orientation: int) -> np.ndarray:
    """A view of pixels (H, W, ...) with an EXIF orientation, 1 to 8, applied."""
    if orientation in EXCHANGING:
        pixels = pixels.swapaxes(0, 1)
    # Orientations by where the stored top row and left column belong (EXIF 2.3, 4.6.4).
    pixels = pixels[:: -1 if orientation in (3, 4, 7, 8) else 1]
    return pixels[:, :: -1 if orientation in (2, 3, 6, 7) else 1]


def load_image(source: ImageSource, name: str = "image") -> Image:
    """Load an upright image as 8-bit RGB.

    source: a path, an array or a torch tensor (H, W), (H, W, C) or (C, H, W) with C of 1, 3 or 4,
    grey or RGB(A), or a batch of one image. If the axes are ambiguous, an array has the channels
    last, a tensor first. An `Image` is returned unchanged. name: of the argument, for errors.

    The EXIF orientation of a file is applied. Grey becomes three equal channels. Pixels with alpha
    0 become the `mask` and get the mean colour of the others. 8-bit values stay. Floats within
    [0, 1] are multiplied by 255. All other values (16 bit, 12 bit in 16, other floats) are rescaled
    to 0 to 255, with one range for all colours; a few outliers saturate.

    Raises ImageError, with the path, if a file is missing, empty, of an unknown format, corrupt,
    too large or has alpha 0 everywhere; InputError, with `name`, if an array has another shape, is
    empty, not finite or has alpha 0 everywhere.
    """
    if source is None or isinstance(source, bytes) or (isinstance(source, str) and "://" in source):
        raise InputError(f"{name} is not a path, an array or a tensor: {source!r:.60}")
    if isinstance(source, str | os.PathLike):
        source = _read_file(Path(source))
    if isinstance(source, Image):
        return source
    array = as_numpy(source, name)
    if array.ndim == 4 and array.shape[0] == 1:
        array = array[0]
    is_last = not is_tensor(source) and array.shape[-1:] in ((1,), (3,), (4,))
    if array.ndim == 3 and array.shape[0] in (1, 3, 4) and not is_last:
        array = np.moveaxis(array, 0, 2)
    return _from_array(array, name)


def _read_file(path: Path) -> Image:
    with image_errors(path):
        array, header = decoded(path)
        if array.dtype == np.uint8 and array.ndim == 3 and array.shape[2] == 3:
            array = cv2.cvtColor(array, cv2.COLOR_BGR2RGB, dst=array)  # in place: it may be large
        elif array.ndim == 3 and array.shape[2] >= 3:
            array = array[:, :, [2, 1, 0, 3][: array.shape[2]]]  # OpenCV stores BGR(A)
        image = _from_array(turned(array, header.exif.orientation), path)
        aspect = header.pixel_aspect
        projection = header.projection
        return replace(image, exif=header.exif, pixel_aspect=aspect, projection=projection)


def _from_array(array: np.ndarray, name: str | Path) -> Image:
    if array.ndim == 2:
        array = array[:, :, None]
    if array.ndim != 3 or array.shape[2] not in (1, 3, 4) or array.size == 0:
        raise InputError(
            name, f"must have shape (H, W), (H, W, 1), (H, W, 3) or (H, W, 4), not {array.shape}"
        )
    colours = array[:, :, :3]
    used = None
    if array.shape[2] == 4 and not (array[:, :, 3] != 0).all():
        used = array[:, :, 3] != 0
        if not used.any():
            raise InputError(name, "has alpha 0 everywhere: no pixel is left to match")
        colours = filled(colours, used)
    colours = _to_8_bit(colours, name)
    if colours.shape[2] == 1:
        colours = np.repeat(colours, 3, axis=2)
    return Image(np.ascontiguousarray(colours), str(name), mask=used)


def filled(pixels: np.ndarray, used: np.ndarray) -> np.ndarray:
    """A copy of pixels (H, W, C), where pixels not `used` (H, W) get the mean colour of the others.
    Otherwise the network would match them."""
    pixels = pixels.copy()
    pixels[~used] = pixels[used].mean(0, dtype=np.float64)
    return pixels


def _to_8_bit(array: np.ndarray, name: str | Path) -> np.ndarray:
    if array.dtype == np.uint8:
        return array
    low = float(array.min())
    high = float(array.max())
    if not np.isfinite(high - low):
        raise InputError(name, "has values that are not finite")
    if array.dtype.kind in "bf" and low >= 0 and high <= 1:
        low = 0.0
        high = 1.0
    else:
        low, high = _shown_range(array, low, high)
    scale = 255 / (high - low) if high > low else 0.0
    # float32 holds 16 bits exactly and halves the memory of a large image.
    values: np.ndarray = array.astype(np.float32 if array.dtype.itemsize <= 2 else np.float64)
    return np.rint((values - low) * scale).clip(0, 255).astype(np.uint8)


def _shown_range(array: np.ndarray, low: float, high: float) -> tuple[float, float]:
    """The values that become 0 and 255: the 1st and 99th percentile, extended by half their
    distance, within low and high. The percentiles ignore `low` and `high`, which may mean no data
    or come from one pixel, and a value that nearly all pixels have."""
    step = max(array.shape) // 1000 + 1  # a sample of the pixels suffices
    values = array[::step, ::step]
    values = values[(values > low) & (values < high)]
    while values.size:
        first, last = map(float, np.percentile(values, (1, 99)))
        if first < last:
            return max(low, 1.5 * first - 0.5 * last), min(high, 1.5 * last - 0.5 * first)
        values = values[values != first]
    return low, high


def masked(image: Image, source: MaskSource, name: str = "") -> Image:
    """Add a mask to an image.

    source: a path, or an array (H, W) or (H, W, C), whose second or fourth channel is alpha; None
    returns the image unchanged. The mask refers to the stored pixels: the EXIF orientation is
    applied to it, and its size is scaled to that of the image. Pixels that are 0, False, black or
    have alpha 0 are not matched, nor are pixels that the image has masked already; they get the
    mean colour of the others. name: of the argument, for errors; without it, errors have the path.

    Raises ImageError, with the path, if a file cannot be read; InputError, with `name`, if an array
    has another shape, if the aspect ratios differ, and if no pixel of the image is left.
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
    height, width = used.shape
    columns, rows = image.size
    if abs(width * rows / (height * columns) - 1) > SAME_SHAPE:
        raise InputError(argument, f"is {width} x {height} and the image {columns} x {rows}")
    if (width, height) != image.size:
        used = resized_mask(used, image.size)
    used &= True if image.mask is None else image.mask
    if not used.any():
        raise InputError(argument, "leaves no pixel of the image to match")
    return replace(image, pixels=filled(image.pixels, used), mask=used)


def load_pair(
    images: tuple[ImageSource, ImageSource], masks: tuple[MaskSource, MaskSource] = (None, None)
) -> tuple[Image, Image]:
    """Load two images with their masks. Raises as `load_image` and `masked`, for the arguments
    image1, image2, mask1 and mask2."""

    def load(number: int) -> Image:
        image = load_image(images[number], f"image{number + 1}")
        return masked(image, masks[number], f"mask{number + 1}")

    first, second = in_threads(load, (0, 1))
    return first, second


def resized_mask(mask: np.ndarray, size: Size) -> np.ndarray:
    """Resize a bool mask (H, W) to (width, height): nearest pixels by the half-pixel rule."""
    nearest = cv2.INTER_NEAREST_EXACT
    return cv2.resize(mask.astype(np.uint8), size, interpolation=nearest).astype(bool)


def mask_file(folder: str | Path | None, name: str) -> Path | None:
    """The mask of the image `name` in a folder: `name`.png, COLMAP's convention, or None."""
    path = None if folder is None else Path(f"{folder}/{name}.png")
    return path if path and os.path.lexists(path) else None


def resize(pixels: np.ndarray, size: tuple[int, int]) -> np.ndarray:
    """Resize an image (H, W[, 3]) to `size` (width, height), with its outer edges in place: area
    means to shrink, bilinear to enlarge. A large image with even sides of at least four times
    `size` is halved first, which is far faster."""
    height, width = pixels.shape[:2]
    while (
        width * height > _LARGE
        and min(width / size[0], height / size[1]) >= 4
        and width % 2 == height % 2 == 0
    ):
        width = width // 2
        height = height // 2
        pixels = cv2.resize(pixels, (width, height), interpolation=cv2.INTER_AREA)
    shrunk = (min(size[0], width), min(size[1], height))
    if shrunk != (width, height):
        pixels = cv2.resize(pixels, shrunk, interpolation=cv2.INTER_AREA)
    if shrunk != size:
        pixels = cv2.resize(pixels, size, interpolation=cv2.INTER_LINEAR)
    return pixels


def resize_by(pixels: np.ndarray, scale: float) -> np.ndarray:
    """`resize` by one factor for both axes; the sides are rounded, and at least 1 pixel."""
    height, width = pixels.shape[:2]
    return resize(pixels, (max(1, round(width * scale)), max(1, round(height * scale))))


def picture_url(pixels: np.ndarray, kind: Literal["jpeg", "webp"], *settings: int) -> str:
    """Encode an image (H, W, 3 or 4) uint8, RGB or RGBA, as a data URL."""
    order = [2, 1, 0, 3][: pixels.shape[2]]
    done, data = cv2.imencode(f".{kind}", np.ascontiguousarray(pixels[..., order]), list(settings))
    assert done
    return f"data:image/{kind};base64,{base64.b64encode(data.tobytes()).decode()}"
