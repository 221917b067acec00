"""The cache of features of images in their own shape, and that shape."""

from __future__ import annotations

import numpy as np
import torch

from dgc_pose.images.image import Image
from dgc_pose.network.config import preset
from dgc_pose.network.net import DGCNet
from dgc_pose.refinement.features import cells_at, native_cache
from dgc_pose.runtime.torch_engine import TorchEngine


def test_sides_become_the_nearest_multiples_of_16() -> None:
    assert cells_at((320, 200), 0.5) == (10, 6)
    assert cells_at((100, 90), 1.0) == (6, 6)
    assert cells_at((1600, 1200), 0.5) == (50, 38)
    assert cells_at((1600, 3), 0.1) == (10, 1)


def test_a_cache_counts_images_and_features() -> None:
    torch.manual_seed(0)
    engine = TorchEngine(DGCNet(preset("dgcm-lite0")))
    cache = native_cache()
    image = Image(np.random.default_rng(0).integers(0, 256, (48, 64, 3), dtype=np.uint8))
    for _ in range(2):
        found = cache.get((image, 0, (4, 3)), lambda: engine.native(image.pixels, (4, 3)))
    assert (cache.asked, cache.made) == (2, 1)
    values = sum(level.size for level in (found.coarse, found.middle, found.fine))
    assert cache.held_bytes == image.pixels.nbytes + 4 * values
