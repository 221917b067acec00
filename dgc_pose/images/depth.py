"""Depth maps: 1 / depth at the pixels of a photograph."""

from __future__ import annotations

from pathlib import Path

import cv2
import numpy as np

from dgc_pose.errors import ArgumentName, InputError
from dgc_pose.geometry.pixels import Size
from dgc_pose.images.decoding import read_pixels
from dgc_pose.images.image import SAME_SHAPE, turned
from dgc_pose.system.arrays import read_array, read_arrays

_WINDOW = 3, 3  # pixels of a depth map
_STRADDLES = 0.05  # a window whose depths differ by a larger share covers several surfaces


def read_depth(
    source: str | Path | np.ndarray | None, name: str, size: Size, orientation: int
) -> np.ndarray | None:
    """1 / depth (H, W), 1 / metres, at the pixels of a photograph of `size`; NaN where unknown.

    source: a depth map of any size, or its .npy, .npz with one array, PNG or TIFF; None returns
    None. Integers are millimetres, floats metres. Edges and values that are not finite and above 0
    are unknown. orientation: EXIF orientation of the map; the photograph is already upright. Raises
    InputError with `name`; for a damaged file InputError or ImageError, with the path.
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
    if abs(depth.shape[1] * size[1] / (depth.shape[0] * size[0]) - 1) > SAME_SHAPE:
        aspect = f"another aspect ratio than the {size[0]} x {size[1]} pixels of the photograph"
        raise InputError(ArgumentName(name), f"{shape}, {aspect}")
    inverse = np.divide(1, depth, out=np.zeros(depth.shape, np.float32), where=known)
    least = cv2.erode(np.where(known, inverse, np.float32(np.inf)), np.ones(_WINDOW))
    is_surface = cv2.dilate(inverse, np.ones(_WINDOW)) / (1 + _STRADDLES) <= least
    with np.errstate(invalid="ignore"):  # windows without a known depth
        mean = cv2.blur(inverse, _WINDOW) / cv2.blur(known.astype(np.float32), _WINDOW)
    # Inverse depth is linear in the pixels on a plane; by the half-pixel rule.
    return cv2.resize(np.where(is_surface, mean, np.float32(np.nan)), size)


def _read(path: Path) -> np.ndarray:
    if path.suffix.lower() not in (".npy", ".npz"):
        return read_pixels(path)
    arrays = read_arrays(path) if path.suffix.lower() == ".npz" else {"": read_array(path)}
    if len(arrays) != 1:
        raise InputError(path, f"holds {len(arrays)} arrays, and a depth map is one")
    return next(iter(arrays.values()))
