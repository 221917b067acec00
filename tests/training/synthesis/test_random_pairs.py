"""Random pairs: the map and its valid pixels agree with the images."""

from dataclasses import replace

import pytest
import torch
import torch.nn.functional as F
from procedural import procedural_textures
from still_light import STILL

from dgc_pose.training.map_pairs import MapPairs
from dgc_pose.training.synthesis.options import PairOptions
from dgc_pose.training.synthesis.photometric import random_photometric
from dgc_pose.training.synthesis.photos import Photos
from dgc_pose.training.synthesis.random_pairs import make_pairs


@pytest.fixture(scope="module")
def photos() -> Photos:
    textures = procedural_textures(8, 128, seed=0)
    return Photos.of((255 * textures).round().to(torch.uint8))


def _pairs(photos: Photos, seed: int = 0, **changes: object) -> MapPairs:
    options = replace(PairOptions(photometric=STILL), **changes)  # type: ignore[arg-type]
    return make_pairs(photos, 6, 96, torch.Generator().manual_seed(seed), options)


def _fetched(pairs: MapPairs) -> torch.Tensor:
    size = pairs.image1.shape[-1]
    return F.grid_sample(pairs.image1, (2 * pairs.map + 1) / size - 1, align_corners=False)


def test_warped_views_agree_where_valid(photos: Photos) -> None:
    pairs = _pairs(photos, scene_share=0.0)
    difference = (_fetched(pairs) - pairs.image2).abs().mean(1)
    assert 0.3 < float(pairs.valid.float().mean()) < 0.98
    assert float(difference[pairs.valid].median()) < 0.03
    shuffled = (_fetched(pairs) - pairs.image2.roll(1, 0)).abs().mean(1)
    assert float(difference[pairs.valid].mean()) < 0.4 * float(shuffled[pairs.valid].mean())


def test_occluders_are_not_valid(photos: Photos) -> None:
    """With something before every view, fewer pixels are valid, and the map stays the same."""
    free = _pairs(photos, scene_share=0.0, occluder_share=0.0)
    hidden = _pairs(photos, scene_share=0.0, occluder_share=1.0)
    assert torch.equal(free.map, hidden.map)
    lost = free.valid & ~hidden.valid
    assert lost.any() and not (hidden.valid & ~free.valid).any()
    changed = ((free.image2 - hidden.image2).abs() > 1e-3).any(1)
    assert not (changed & hidden.valid).any()


def test_the_same_seed_gives_the_same_pairs(photos: Photos) -> None:
    one, two, other = (_pairs(photos, seed) for seed in (3, 3, 4))
    for name in ("image1", "image2", "map", "valid"):
        assert torch.equal(getattr(one, name), getattr(two, name))
    assert not torch.equal(one.image1, other.image1)


def test_blur_keeps_the_mean_and_lowers_the_contrast() -> None:
    images = 0.2 + 0.6 * torch.rand(4, 3, 32, 32, generator=torch.Generator().manual_seed(3))
    options = replace(STILL, blur_share=1.0, blur_sigma=2.0)
    blurred = random_photometric(images, options, torch.Generator().manual_seed(4))
    torch.testing.assert_close(blurred.mean((2, 3)), images.mean((2, 3)), atol=0.02, rtol=0)
    assert (blurred.std((2, 3)) < images.std((2, 3))).all()
