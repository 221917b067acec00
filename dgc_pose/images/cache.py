"""Images by name and what is computed of images, kept for the pairs that they belong to."""

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

_LAST = 3  # images: of a pair, and the mirror image of one
Wanted = tuple[Image, Hashable, Callable[[], Any]]  # an image, a key, and what makes the value


class ImageCache:
    """Images that were read, and values with `nbytes` that are computed of images, by their keys.

    limit_bytes: the images used least recently are dropped, with all that is computed of them, if
    all take more; the latest is always kept. None to keep the last three images. beside_bytes: what
    an image's values take at the least, which is so free before they are computed.
    """

    def __init__(self, limit_bytes: int | None = 3 * 2**28, *, beside_bytes: int = 0) -> None:
        self.limit_bytes, self.beside_bytes = limit_bytes, beside_bytes
        self.made = 0  # values computed
        self._kept: OrderedDict[Image, dict[Hashable, Any]] = OrderedDict()
        self._read: dict[Hashable, Image] = {}
        self._held = 0  # bytes of all images and values

    def read(
        self, root: Path, name: str, masks: str | Path | None = None, size: Size | None = None
    ) -> Image:
        """The image `name` of a folder, with its mask in the folder `masks` (see `mask_file`), at a
        size (width, height). Raises ImageError and InputError as `load_image` and `masked` do."""
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
        """A value of an image; computed by `make` if it is not kept."""
        values = self._values(image)
        if key in values:
            return values[key]
        value = make()
        values = self._values(image)  # other values that were made meanwhile may have dropped it
        before = self._bytes(image)
        values[key] = value
        self._held += self._bytes(image) - before
        self.made += 1
        self._values(image)
        return value

    def get_all(self, wanted: Sequence[Wanted], *, in_turn: bool) -> list[Any]:
        """As `get` of each. Those that are not kept are made in threads, or else in turn."""
        makes = {
            (image, key): make
            for image, key, make in wanted
            if not in_turn and key not in self._kept.get(image, {})
        }
        values = in_threads(lambda make: make(), list(makes.values()))
        makes = {of: partial(lambda it: it, value) for of, value in zip(makes, values, strict=True)}
        return [self.get(image, key, makes.get((image, key), make)) for image, key, make in wanted]

    def forget(self, image: Image) -> None:
        """Drop an image, and all that is computed of it."""
        if image in self._kept:
            self._held -= self._bytes(image)
            del self._kept[image]
        self._read = {key: read for key, read in self._read.items() if read is not image}

    def _values(self, image: Image) -> dict[Hashable, Any]:
        """The values of an image, which is the latest now."""
        if image not in self._kept:
            self._kept[image] = {}
            self._held += self._bytes(image)
        self._kept.move_to_end(image)
        while len(self._kept) > 1 and self._is_full():
            self.forget(next(iter(self._kept)))
        return self._kept[image]

    def _bytes(self, image: Image) -> int:
        """What an image takes that is kept, with its values."""
        beside = sum(value.nbytes for value in self._kept[image].values())
        return int(image.pixels.nbytes) + max(beside, self.beside_bytes)

    def _is_full(self) -> bool:
        if self.limit_bytes is None:
            return len(self._kept) > _LAST
        return self._held > self.limit_bytes
