"""What is made of an image, kept: an image that stands in many pairs is read and encoded once."""

from __future__ import annotations

from collections import OrderedDict
from collections.abc import Callable, Hashable
from typing import Generic, TypeVar

Key = TypeVar("Key", bound=Hashable)
Value = TypeVar("Value")

DEFAULT_BYTES = 2 * 2**30


class BoundedCache(Generic[Key, Value]):
    """Values by key; those that were not asked for longest are dropped where all together would
    take more than `limit_bytes`. The last one is always kept."""

    def __init__(
        self, size: Callable[[Key, Value], int], limit_bytes: int = DEFAULT_BYTES
    ) -> None:
        self._size = size
        self.limit_bytes = limit_bytes
        self.held_bytes = 0
        self.asked = 0
        self.made = 0  # of those asked for; the others were there
        self._kept: OrderedDict[Key, Value] = OrderedDict()

    def get(self, key: Key, make: Callable[[], Value]) -> Value:
        """The value of a key, by `make` where it is not there."""
        self.asked += 1
        if key in self._kept:
            self._kept.move_to_end(key)
            return self._kept[key]
        value = make()
        self.made += 1
        self._kept[key] = value
        self.held_bytes += self._size(key, value)
        while self.held_bytes > self.limit_bytes and len(self._kept) > 1:
            self.held_bytes -= self._size(*self._kept.popitem(last=False))
        return value
