"""The encoder's features of images in their own shape, kept from pair to pair."""

from __future__ import annotations

from dgc_pose.images.image import Image
from dgc_pose.matching.cache import BoundedCache
from dgc_pose.matching.view import View
from dgc_pose.network.config import STRIDE
from dgc_pose.runtime.engine import NativeFeatures

# Features by image (the object, not its pixels), view of it, and columns and rows of stride 16.
NativeCache = BoundedCache[tuple[Image, View, tuple[int, int]], NativeFeatures]


def native_cache() -> NativeCache:
    """A cache of the default size. The images that it keeps alive count towards it."""
    return BoundedCache(lambda key, features: key[0].pixels.nbytes + features.nbytes)


def cells_at(size: tuple[int, int], scale: float) -> tuple[int, int]:
    """Columns and rows of stride 16 of an image of `size` (width, height) resized by `scale`.

    Each side becomes the nearest multiple of 16, so the actual scale differs a little.
    """
    columns, rows = (max(1, round(side * scale / STRIDE)) for side in size)
    return columns, rows
