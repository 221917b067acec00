"""The cache of images: what is kept and dropped, and what of an image is read."""

from collections.abc import Callable
from pathlib import Path

import cv2
import numpy as np
import pytest

from dgc_pose.errors import ImageError
from dgc_pose.images.cache import ImageCache
from dgc_pose.images.image import Image

IMAGES = [Image(np.zeros((2, 5, 3), np.uint8)) for _ in range(5)]  # 30 bytes each
VALUE = np.zeros(10, np.uint8)
PIXELS = np.random.default_rng(0).integers(0, 256, (30, 40, 3), np.uint8)


@pytest.fixture
def photos(tmp_path: Path) -> Path:
    for name in ("a.png", "b.png", "c.png"):
        cv2.imwrite(str(tmp_path / name), PIXELS)
    return tmp_path


def test_the_image_used_least_recently_is_dropped_with_its_values() -> None:
    """0, 1, 2 are made; 0 is kept; 3 drops 1; 1 is made again and drops 2; 0 is kept."""
    cache = ImageCache(3 * (30 + 2 * 10))
    for number in (0, 1, 2, 0, 3, 1, 0):
        for key in "aba":
            assert cache.get(IMAGES[number], key, VALUE.copy) is not VALUE
        assert len(cache._kept) <= 3
    assert cache.made == 2 * 5
    cache.forget(IMAGES[0])
    assert list(cache._kept) == [IMAGES[3], IMAGES[1]]
    cache = ImageCache(3 * (30 + 20), beside_bytes=45)  # room for two that are computed
    for image in IMAGES[:3]:
        cache.get(image, "a", VALUE.copy)
    assert list(cache._kept) == IMAGES[1:3]


@pytest.mark.parametrize("in_turn", [True, False])
def test_of_many_each_that_is_missing_is_made_once(in_turn: bool) -> None:
    """With room for two: 2 drops 0, which is made again for the last."""
    cache, made = ImageCache(2 * (30 + 10)), []

    def maker(number: int) -> Callable[[], np.ndarray]:
        return lambda: made.append(number) or VALUE + number

    cache.get(IMAGES[0], "a", maker(0))
    wanted = [0, 1, 1, 2, 0]
    found = cache.get_all([(IMAGES[n], "a", maker(n)) for n in wanted], in_turn=in_turn)
    assert [value[0] for value in found] == wanted
    assert sorted(made) == [0, 0, 1, 2]


def test_without_a_limit_the_last_three_images_are_kept() -> None:
    cache = ImageCache(None)
    for number in (0, 1, 0, 2, 1, 0, 3):  # the last drops 2
        cache.get(IMAGES[number], "a", VALUE.copy)
    assert cache.made == 4 and list(cache._kept) == [IMAGES[1], IMAGES[0], IMAGES[3]]


def test_images_that_were_read_are_kept_with_what_is_computed_of_them(photos: Path) -> None:
    cache = ImageCache(2 * (PIXELS.nbytes + 10))
    first, second = cache.read(photos, "a.png"), cache.read(photos, "b.png")
    cache.get(first, "a", VALUE.copy)
    assert cache.read(photos, "a.png") is first
    cache.read(photos, "c.png")
    assert second not in cache._kept and cache.read(photos, "a.png") is first
    cache.limit_bytes = 1
    third = cache.read(photos, "b.png")
    assert third is not second and list(cache._kept) == [third]
    (photos / "b.png").unlink()
    assert cache.read(photos, "b.png") is third
    cache.forget(third)
    with pytest.raises(ImageError, match=r"b\.png"):
        cache.read(photos, "b.png")


def test_images_have_their_masks_and_the_size_asked_for(photos: Path) -> None:
    mask = np.full((30, 40), 255, np.uint8)
    mask[:, :20] = 0
    (photos / "masks").mkdir()
    cv2.imwrite(str(photos / "masks/a.png.png"), mask)
    cache = ImageCache()
    image = cache.read(photos, "a.png", photos / "masks")
    assert image.mask is not None and np.array_equal(image.mask, mask > 0)
    assert cache.read(photos, "b.png", photos / "masks").mask is None
    small = cache.read(photos, "a.png", photos / "masks", size=(20, 20))
    assert small.size == (20, 20) and small.stored_size == (40, 30) and small.mask is not None
    assert not small.mask[:, :10].any() and small.mask[:, 10:].all()
