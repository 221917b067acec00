"""The cache: what it keeps and drops."""

from collections.abc import Callable

import numpy as np
import pytest

from dgc_pose.images.image import Image
from dgc_pose.matching.cache import BoundedCache, LastImages


def _cache(limit: int) -> BoundedCache[str, bytes]:
    return BoundedCache(lambda key, value: len(value), limit)


def test_the_least_recently_used_is_dropped() -> None:
    cache = _cache(limit=30)
    for key in ("a", "b", "c", "a", "d", "b", "a"):
        assert cache.get(key, lambda: 10 * b".") == 10 * b"."
        assert cache.held_bytes <= 30
    # a, b, c are made; a is kept; d is made and drops b; b is made and drops c; a is kept.
    assert (cache.asked, cache.made) == (7, 5)


def test_what_is_dropped_is_told() -> None:
    told: list[bytes] = []
    cache: BoundedCache[str, bytes] = BoundedCache(lambda key, value: 10, 30, told.append)
    for key in ("a", "b", "c", "d"):
        cache.get(key, key.encode)
    assert told == [b"a"]
    cache.drop(lambda key: key in "ac")
    assert told == [b"a", b"c"] and cache.held_bytes == 20
    assert cache.get("c", lambda: b"new") == b"new"


@pytest.mark.parametrize("in_turn", [True, False])
def test_of_many_each_that_is_missing_is_made_once(in_turn: bool) -> None:
    cache, made = _cache(limit=25), []

    def maker(key: str) -> Callable[[], bytes]:
        return lambda: made.append(key) or 10 * key.encode()

    cache.get("a", maker("a"))
    keys = ["a", "b", "b", "c", "a"]
    found = cache.get_all([(key, maker(key)) for key in keys], in_turn=in_turn)
    assert found == [10 * key.encode() for key in keys]
    # With room for two: c drops a, which is made again for the last.
    assert sorted(made) == ["a", "a", "b", "c"]
    assert cache.held_bytes <= 25


def test_what_is_computed_of_the_last_three_images_is_kept() -> None:
    cache, images = LastImages(), [Image(np.zeros((2, 3, 3), np.uint8)) for _ in range(4)]
    value = np.zeros(5)
    for number in (0, 1, 0, 2, 1, 0):
        for name in ("a", "b"):
            assert cache.get((images[number], name), value.copy) is not value
    assert (cache.made, cache.held_bytes) == (6, 6 * value.nbytes)
    cache.get((images[3], "a"), value.copy)  # drops image 2, the least recently used
    assert cache.held_bytes == 5 * value.nbytes
    cache.get((images[0], "b"), value.copy)
    assert cache.made == 7
    cache.get((images[2], "a"), value.copy)
    assert cache.made == 8
