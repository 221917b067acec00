"""A cache of images and of the values computed from them, for pairs that share images."""

from __future__ import annotations

from collections import OrderedDict
from collections.abc import Callable, Hashable, Sequence
from dataclasses import replace
from functools import partial
from pathlib import Path
from typing import Any

from dgc_pose.geometry.pixels import Size
from dgc_pose.images.image import Image, load_image, mask_file, masked, resize, resized_mask
from dgc_pose.system.parallel import in_threads

_LAST = 3  # images: those of a pair, and the mirror image of one
Wanted = tuple[Image, Hashable, Callable[[], Any]]  # an image, a key, and a function for the value


class ImageCache:
    """Images that were read, and values with `nbytes` computed from them, by key.

    limit_bytes: above this total, the cache drops the least recently used images with their values,
    but never the latest image. None keeps the last three images. beside_bytes: least size counted
    for the values of an image, which reserves memory before they are computed.
    """

    def __init__(self, limit_bytes: int | None = 3 * 2**28, *, beside_bytes: int = 0) -> None:
        self.limit_bytes = limit_bytes
        self.beside_bytes = beside_bytes
        self.made = 0  # values computed
        self._kept: OrderedDict[Image, dict[Hashable, Any]] = OrderedDict()
        self._read: dict[Hashable, Image] = {}
        self._held = 0  # bytes of all images and values

    def read(
        self, root: Path, name: str, masks: str | Path | None = None, size: Size | None = None
    ) -> Image:
        """Read the image `name` of the folder `root`, with its mask in the folder `masks` (see
        `mask_file`), resized to `size` (width, height). Raises as `load_image` and `masked` do."""
        key = root, name, masks, size
        image = self._read.get(key)
        if image is None:
            image = masked(load_image(root / name), mask_file(masks, name))
            if size is not None:
                mask = None if image.mask is None else resized_mask(image.mask, size)
                pixels = resize(image.pixels, size)
                image = replace(image, pixels=pixels, mask=mask, stored_size=image.size)
            self._read[key] = image
        self._values(image)
        return image

    def get(self, image: Image, key: Hashable, make: Callable[[], Any]) -> Any:
        """The value of an image for a key; `make` computes it if it is not cached."""
        values = self._values(image)
        if key in values:
            return values[key]
        value = make()
        values = self._values(image)  # `make` may have caused the image to be dropped
        before = self._bytes(image)
        values[key] = value
        self._held += self._bytes(image) - before
        self.made += 1
        self._values(image)
        return value

    def get_all(self, wanted: Sequence[Wanted], *, in_turn: bool) -> list[Any]:
        """`get` for each of `wanted`. Missing values are computed in threads, or one after another
        if `in_turn`."""
        missing = {}
        for image, key, make in wanted:
            if not in_turn and key not in self._kept.get(image, {}):
                missing[image, key] = make
        made = in_threads(lambda make: make(), list(missing.values()))
        values = dict(zip(missing, made, strict=True))

        result = []
        for image, key, make in wanted:
            is_made = (image, key) in values
            result.append(
                self.get(image, key, partial(values.get, (image, key)) if is_made else make)
            )
        return result

    def forget(self, image: Image) -> None:
        """Drop an image and its values."""
        if image in self._kept:
            self._held -= self._bytes(image)
            del self._kept[image]
        self._read = {key: read for key, read in self._read.items() if read is not image}

    def _values(self, image: Image) -> dict[Hashable, Any]:
        """Mark an image as the latest, drop old ones above the limit, and return its values."""
        if image not in self._kept:
            self._kept[image] = {}
            self._held += self._bytes(image)
        self._kept.move_to_end(image)
        while len(self._kept) > 1 and self._is_full():
            self.forget(next(iter(self._kept)))
        return self._kept[image]

    def _bytes(self, image: Image) -> int:
        beside = sum(value.nbytes for value in self._kept[image].values())
        return int(image.pixels.nbytes) + max(beside, self.beside_bytes)

    def _is_full(self) -> bool:
        if self.limit_bytes is None:
            return len(self._kept) > _LAST
        return self._held > self.limit_bytes
