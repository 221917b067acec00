"""A cache of what is computed from an image, for images that belong to several pairs."""

from collections import OrderedDict
from collections.abc import Callable, Hashable, Sequence
from functools import partial
from typing import Any, Generic, TypeVar

from dgc_pose.system.threads import in_threads

Key = TypeVar("Key", bound=Hashable)
Value = TypeVar("Value")


class BoundedCache(Generic[Key, Value]):
    """Values by key. The least recently used are dropped if all together take more than
    `limit_bytes`; the latest is always kept.

    dropped: called with each value that is dropped.
    """

    def __init__(
        self,
        size: Callable[[Key, Value], int],
        limit_bytes: int = 2 * 2**30,
        dropped: Callable[[Value], None] = lambda value: None,
    ) -> None:
        self._size = size
        self._dropped = dropped
        self.limit_bytes = limit_bytes
        self.held_bytes = 0
        self.asked = 0  # calls of `get`
        self.made = 0  # of those, how many computed the value
        self._kept: OrderedDict[Key, Value] = OrderedDict()

    def get_all(
        self, wanted: Sequence[tuple[Key, Callable[[], Value]]], *, in_turn: bool
    ) -> list[Value]:
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

    def get(self, key: Key, make: Callable[[], Value]) -> Value:
        """The value of a key; computed by `make` if it is not in the cache."""
        self.asked += 1
        if key in self._kept:
            self._kept.move_to_end(key)
            return self._kept[key]
        value = make()
        self.made += 1
        self._kept[key] = value
        self.held_bytes += self._size(key, value)
        while self.held_bytes > self.limit_bytes and len(self._kept) > 1:
            self._drop(next(iter(self._kept)))
        return value

    def drop(self, unwanted: Callable[[Key], bool]) -> None:
        """Drop the values of the keys that are not wanted any more."""
        for key in [key for key in self._kept if unwanted(key)]:
            self._drop(key)

    def _drop(self, key: Key) -> None:
        value = self._kept.pop(key)
        self.held_bytes -= self._size(key, value)
        self._dropped(value)


# What is computed of an image, by the image first (the object, not its pixels).
ImageCache = BoundedCache[tuple[Any, ...], Any]


def image_cache(limit_bytes: int = 2 * 2**30) -> ImageCache:
    """A cache of this size of values with `nbytes`. The images that it keeps alive count, too."""
    return BoundedCache(lambda key, value: key[0].pixels.nbytes + value.nbytes, limit_bytes)


class LastImages(ImageCache):
    """What is computed of the last three images: of a pair, and of the mirror image of one."""

    def __init__(self) -> None:
        super().__init__(lambda key, value: value.nbytes)

    def get(self, key: tuple[Any, ...], make: Callable[[], Any]) -> Any:
        value = super().get(key, make)
        images = list(dict.fromkeys(kept[0] for kept in reversed(self._kept)))
        self.drop(lambda kept: kept[0] not in images[:3])
        return value
