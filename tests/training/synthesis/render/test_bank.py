"""Texture look-ups against loops and other samplers."""

import numpy as np
import torch
from torch.nn.functional import avg_pool2d, grid_sample

from dgc_pose.training.synthesis.render.bank import TextureBank

PHOTOS = (torch.rand(3, 3, 24, 40, generator=torch.Generator().manual_seed(0)) * 255).round()
BANK = TextureBank.from_photos(PHOTOS.byte())


def sampled(photo: int, x: np.ndarray, y: np.ndarray, footprint: float) -> torch.Tensor:
    x, y = torch.from_numpy(np.float32(x)), torch.from_numpy(np.float32(y))
    index = torch.full(x.shape, photo)
    return BANK.sample(index, x, y, torch.full_like(x, footprint))


def test_each_level_is_sampled_as_grid_sample_does():
    rng = np.random.default_rng(1)
    x, y = rng.uniform(0, 40, 500), rng.uniform(0, 24, 500)
    grid = torch.from_numpy(np.float32(np.stack((x / 20 - 1, y / 12 - 1), -1)))[None, None]
    for level in range(BANK.levels):
        reduced = PHOTOS[1:2] if level == 0 else avg_pool2d(PHOTOS[1:2], 2**level)
        expected = grid_sample(reduced, grid, padding_mode="border", align_corners=False)[0, :, 0]
        # Levels are rounded to 8 bits, each from the unrounded one before.
        assert (sampled(1, x, y, 2.0**level) * 255 - expected).abs().max() < 0.51


def test_textures_repeat_by_mirroring():
    rng = np.random.default_rng(2)
    x, y = rng.uniform(0, 40, 200), rng.uniform(0, 24, 200)
    expected = sampled(2, x, y, 1.0)
    for moved_x, moved_y in ((-x, y), (80 - x, y), (x + 80, -y), (x - 160, 48 - y)):
        assert torch.allclose(sampled(2, moved_x, moved_y, 1.0), expected, atol=1e-3)


def test_many_photos_keep_their_order():
    """More than are reduced at a time."""
    photos = torch.randint(0, 256, (600, 3, 8, 8), generator=torch.Generator().manual_seed(3))
    bank = TextureBank.from_photos(photos.byte())
    index, middle = torch.arange(600), torch.full((600,), 2.5)
    fine = bank.sample(index, middle, middle, torch.ones(600))
    assert torch.allclose(fine, photos[:, :, 2, 2].t() / 255, atol=1e-6)
    coarse = bank.sample(index, middle.fill_(2.0), middle, torch.full((600,), 2.0))
    expected = photos.float().unfold(2, 2, 2).unfold(3, 2, 2).mean((4, 5))
    between = expected[:, :, :2, :2].mean((2, 3))
    assert torch.allclose(coarse, between.t() / 255, atol=0.51 / 255)
