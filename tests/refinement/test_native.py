"""The encoder's features of an image at its own shape."""

from __future__ import annotations

import numpy as np
import pytest
import torch
import torch.nn.functional as F

from dgc_pose.image import Image
from dgc_pose.network.config import preset
from dgc_pose.network.net import DGCNet
from dgc_pose.network.statistics import normalise
from dgc_pose.refinement.native import cells_at, native_cache, native_features


@pytest.fixture(scope="module")
def net() -> DGCNet:
    torch.manual_seed(0)
    return DGCNet(preset("dgcm-lite")).eval().requires_grad_(False)


def _noise(width: int, height: int) -> np.ndarray:
    return np.random.default_rng(0).integers(0, 256, (height, width, 3), dtype=np.uint8)


def test_sides_become_the_nearest_multiples_of_16() -> None:
    assert cells_at((320, 200), 0.5) == (10, 6)
    assert cells_at((100, 90), 1.0) == (6, 6)
    assert cells_at((1600, 1200), 0.5) == (50, 38)
    assert cells_at((1600, 3), 0.1) == (10, 1)


def test_levels_have_the_shape_asked_for_and_unit_length(net: DGCNet) -> None:
    found = native_features(net, _noise(320, 200), (10, 6))
    assert found.size == (320, 200)
    for level, times in ((found.coarse, 1), (found.middle, 2), (found.fine, 4)):
        assert level.shape[1:] == (6 * times, 10 * times)
        torch.testing.assert_close(level.norm(dim=0), torch.ones(level.shape[1:]))


@pytest.mark.parametrize("half", [False, True])
def test_half_precision_hardly_changes_the_features(
    net: DGCNet, half: bool, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr("dgc_pose.refinement.native.multiplies_bfloat16", lambda device: half)
    pixels = _noise(96, 64)
    found = native_features(net, pixels, (6, 4))
    planes = torch.from_numpy(pixels).permute(2, 0, 1)[None].double() / 255
    levels = DGCNet(preset("dgcm-lite")).double().pyramid
    levels.load_state_dict({key: value.double() for key, value in net.pyramid.state_dict().items()})
    with torch.no_grad():
        truth = levels(normalise(planes))
    for level, exact in zip((found.fine, found.middle, found.coarse), truth[2:], strict=True):
        cosine = (F.normalize(exact[0], dim=0) * level.double()).sum(0)
        assert cosine.min() > (0.99 if half else 1 - 1e-5)
        assert half == bool(cosine.min() < 1 - 1e-6)  # the monkeypatch does something


def test_a_cache_counts_images_and_features(net: DGCNet) -> None:
    cache = native_cache()
    image = Image(_noise(64, 48))
    for _ in range(2):
        found = cache.get((image, 0, (4, 3)), lambda: native_features(net, image.pixels, (4, 3)))
    assert (cache.asked, cache.made) == (2, 1)
    values = sum(level.numel() for level in (found.coarse, found.middle, found.fine))
    assert cache.held_bytes == image.pixels.nbytes + 4 * values
