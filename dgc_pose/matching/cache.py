"""A cache of what is computed from an image, for images that belong to several pairs."""

from __future__ import annotations

from collections import Counter, OrderedDict
from collections.abc import Callable, Sequence
from functools import partial
from typing import Any

from dgc_pose.system.parallel import in_threads

Key = tuple[Any, ...]  # the image first: the object, not its pixels
_LAST = 3  # images: of a pair, and the mirror image of one


class ImageCache:
    """Values with `nbytes` by their keys.

    limit_bytes: the least recently used are dropped if all take more, together with the images
    that they keep alive; the latest is always kept. None to keep those of the last three images.
    """

    def __init__(self, limit_bytes: int | None = None) -> None:
        self.limit_bytes = limit_bytes
        self.made = 0  # values computed
        self._kept: OrderedDict[Key, Any] = OrderedDict()

    def get_all(
        self, wanted: Sequence[tuple[Key, Callable[[], Any]]], *, in_turn: bool
    ) -> list[Any]:
        """As `get` of each. Those that the cache has not are made in threads, or else in turn."""
        if in_turn:
            return [self.get(key, make) for key, make in wanted]
        missing = {key: make for key, make in wanted if key not in self._kept}
        values = in_threads(lambda make: make(), list(missing.values()))
        made = dict(zip(missing, values, strict=True))
        return [
            self.get(key, partial(made.__getitem__, key) if key in made else make)
            for key, make in wanted
        ]

    def get(self, key: Key, make: Callable[[], Any]) -> Any:
        """The value of a key; computed by `make` if it is not in the cache."""
        if key in self._kept:
            self._kept.move_to_end(key)
            return self._kept[key]
        self._kept[key] = value = make()
        self.made += 1
        if self.limit_bytes is None:
            images = list(dict.fromkeys(kept[0] for kept in reversed(self._kept)))
            self.drop(lambda kept: kept[0] not in images[:_LAST])
            return value
        keys = Counter(kept[0] for kept in self._kept)  # of each image
        held = sum(image.pixels.nbytes for image in keys)
        held += sum(each.nbytes for each in self._kept.values())
        while held > self.limit_bytes and len(self._kept) > 1:
            (image, *_), dropped = self._kept.popitem(last=False)
            keys[image] -= 1
            held -= dropped.nbytes + (image.pixels.nbytes if keys[image] == 0 else 0)
        return value

    def drop(self, unwanted: Callable[[Key], bool]) -> None:
        """Drop the values of the keys that are not wanted any more."""
        for key in [key for key in self._kept if unwanted(key)]:
            del self._kept[key]


def image_cache(limit_bytes: int = 2 * 2**30) -> ImageCache:
    """A cache of this size."""
    return ImageCache(limit_bytes)
