"""The cache: what it keeps and drops."""

from collections.abc import Callable

import numpy as np
import pytest

from dgc_pose.images.image import Image
from dgc_pose.matching.cache import ImageCache, image_cache

IMAGES = [Image(np.zeros((2, 5, 3), np.uint8)) for _ in range(4)]  # 30 bytes each
VALUE = np.zeros(10, np.uint8)


def test_the_least_recently_used_is_dropped() -> None:
    cache = image_cache(3 * (30 + 10))
    for number in (0, 1, 2, 0, 3, 1, 0):
        assert cache.get((IMAGES[number],), VALUE.copy) is not VALUE
        assert len(cache._kept) <= 3
    # 0, 1, 2 are made; 0 is kept; 3 is made and drops 1; 1 is made and drops 2; 0 is kept.
    assert cache.made == 5
    cache.drop(lambda key: key[0] is IMAGES[0])
    assert [key[0] for key in cache._kept] == [IMAGES[3], IMAGES[1]]


def test_an_image_counts_once_whatever_is_kept_of_it() -> None:
    cache = image_cache(30 + 3 * 10)
    for name in "abca":
        cache.get((IMAGES[0], name), VALUE.copy)
    assert cache.made == 3
    cache.get((IMAGES[1], "a"), VALUE.copy)  # two of these are dropped, and image 0 with the third
    assert [key[0] for key in cache._kept] == [IMAGES[1]]


@pytest.mark.parametrize("in_turn", [True, False])
def test_of_many_each_that_is_missing_is_made_once(in_turn: bool) -> None:
    cache, made = image_cache(2 * (30 + 10)), []

    def maker(number: int) -> Callable[[], np.ndarray]:
        return lambda: made.append(number) or VALUE + number

    cache.get((IMAGES[0],), maker(0))
    wanted = [0, 1, 1, 2, 0]
    found = cache.get_all([((IMAGES[n],), maker(n)) for n in wanted], in_turn=in_turn)
    assert [value[0] for value in found] == wanted
    # With room for two: 2 drops 0, which is made again for the last.
    assert sorted(made) == [0, 0, 1, 2]


def test_what_is_computed_of_the_last_three_images_is_kept() -> None:
    cache = ImageCache()
    for number in (0, 1, 0, 2, 1, 0):
        for name in ("a", "b"):
            cache.get((IMAGES[number], name), VALUE.copy)
    assert cache.made == 6
    cache.get((IMAGES[3], "a"), VALUE.copy)  # drops image 2, the least recently used
    assert len(cache._kept) == 5
    cache.get((IMAGES[0], "b"), VALUE.copy)
    assert cache.made == 7
    cache.get((IMAGES[2], "a"), VALUE.copy)
    assert cache.made == 8
