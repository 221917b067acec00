"""The cache: what it keeps and drops, and that a matcher finds the same with one."""

from collections.abc import Callable

import numpy as np
import pytest
import torch

from dgc_pose.images.image import Image
from dgc_pose.matching import DenseMatcher, MatchingOptions
from dgc_pose.matching.cache import BoundedCache, image_cache
from dgc_pose.matching.view import View
from dgc_pose.network.config import preset
from dgc_pose.network.net import DGCNet
from dgc_pose.runtime.torch_engine import TorchEngine


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


def _images(count: int) -> list[Image]:
    rng = np.random.default_rng(0)
    pixels = rng.integers(0, 256, (count, 90, 120, 3), dtype=np.uint8)
    return [Image(one) for one in pixels]


def test_the_encoder_runs_once_an_image_and_rotation() -> None:
    torch.manual_seed(0)
    net = DGCNet(preset("dgcm-lite0"))
    options = MatchingOptions(matchability=0.0)
    engine = TorchEngine(net)
    plain, cached = (DenseMatcher(engine, options, c, 0.0) for c in (None, image_cache()))
    images = _images(3)
    for first, second in ((0, 1), (0, 2), (1, 2)):
        pair = (images[first], images[second])
        expected, found = (matcher.correspondence_map(*pair) for matcher in (plain, cached))
        assert np.array_equal(found.map, expected.map)
        assert np.array_equal(found.matchability, expected.matchability)
    assert cached.cache is not None and (cached.cache.asked, cached.cache.made) == (6, 3)


def test_views_have_features_of_their_own(monkeypatch: pytest.MonkeyPatch) -> None:
    """Features are made for both images, and for the view of image 2 that the search suggests."""
    torch.manual_seed(0)
    options = MatchingOptions(matchability=0.0)
    engine = TorchEngine(DGCNet(preset("dgcm-lite0")))
    matcher, plain = (DenseMatcher(engine, options, c, 1.0) for c in (image_cache(), None))
    images = _images(2)
    suggested = View.whole(images[0].size), View.whole(images[1].size, 50.0)
    monkeypatch.setattr("dgc_pose.matching.dense.search_views", lambda *given: suggested)
    found, expected = (each.correspondence_map(*images) for each in (matcher, plain))
    assert np.array_equal(found.map, expected.map)
    assert matcher.cache is not None and matcher.cache.made == 3
