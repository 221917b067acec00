"""Images by name: what is kept, and what of an image is loaded."""

from pathlib import Path

import cv2
import numpy as np
import pytest

from dgc_pose.errors import ImageError
from dgc_pose.images.image import Image
from dgc_pose.images.store import ImageStore

PIXELS = np.random.default_rng(0).integers(0, 256, (30, 40, 3), np.uint8)
NAMES = ("a.png", "b.png", "c.png")


@pytest.fixture
def photos(tmp_path: Path) -> Path:
    for name in NAMES:
        cv2.imwrite(str(tmp_path / name), PIXELS)
    return tmp_path


def test_the_images_asked_for_last_are_kept(photos: Path) -> None:
    dropped: list[Image] = []
    limit = 2 * (PIXELS.nbytes + 10)
    store = ImageStore(photos, None, limit, beside_bytes=10, dropped=dropped.append)
    first, second = store.get("a.png"), store.get("b.png")
    assert store.get("a.png") is first and not dropped
    store.get("c.png")
    assert dropped == [second] and store.get("a.png") is first
    store.limit_bytes = 1
    third = store.get("b.png")
    assert third is not second and store.get("b.png") is third
    (photos / "b.png").unlink()
    store.get("a.png")
    with pytest.raises(ImageError, match=r"b\.png"):
        store.get("b.png")


def test_images_have_their_masks_and_the_size_asked_for(photos: Path) -> None:
    mask = np.full((30, 40), 255, np.uint8)
    mask[:, :20] = 0
    (photos / "masks").mkdir()
    cv2.imwrite(str(photos / "masks/a.png.png"), mask)
    store = ImageStore(photos, photos / "masks")
    image = store.get("a.png")
    assert image.mask is not None and np.array_equal(image.mask, mask > 0)
    assert store.get("b.png").mask is None
    small = ImageStore(photos, photos / "masks", size=(20, 20)).get("a.png")
    assert small.size == (20, 20) and small.stored_size == (40, 30)
    assert small.mask is not None and small.mask.shape == (20, 20)
    assert not small.mask[:, :10].any() and small.mask[:, 10:].all()
