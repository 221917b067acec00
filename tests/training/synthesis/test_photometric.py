"""Photometric changes: JPEG as OpenCV's encoder does it, blur that moves nothing, noise."""

from dataclasses import replace

import pytest
import torch
from procedural import procedural_textures
from still_light import STILL

from dgc_pose.training.synthesis.photometric import random_photometric


def _changed(images: torch.Tensor, seed: int = 0, **changes: object) -> torch.Tensor:
    options = replace(STILL, **changes)  # type: ignore[arg-type]
    return random_photometric(images, options, torch.Generator().manual_seed(seed))


def test_jpeg_falls_on_its_share_of_the_views() -> None:
    images = procedural_textures(1, 32, seed=3).clamp(0.01, 0.99).repeat(200, 1, 1, 1)
    changed = (_changed(images, jpeg_share=0.3) - images).abs().amax((1, 2, 3)) > 1e-3
    assert 0.2 < float(changed.float().mean()) < 0.4


def test_motion_blur_is_a_stroke_about_the_place() -> None:
    """The blur of a dot keeps its sum and middle, and is long one way and thin the other."""
    dot = torch.full((40, 3, 25, 25), 0.1)
    dot[:, :, 12, 12] = 0.9
    spread = _changed(dot, motion_share=1.0, motion_length=9.0)[:, 0].double() - 0.1
    assert (spread.sum((1, 2)) - 0.8).abs().max() < 1e-4
    axis = torch.arange(25, dtype=torch.float64) - 12
    y, x = torch.meshgrid(axis, axis, indexing="ij")
    weights = spread / spread.sum((1, 2), keepdim=True)
    assert (weights * x).sum((1, 2)).abs().max() < 1e-4
    assert (weights * y).sum((1, 2)).abs().max() < 1e-4
    xx, yy, xy = ((weights * part).sum((1, 2)) for part in (x * x, y * y, x * y))
    values = torch.linalg.eigvalsh(torch.stack([xx, xy, xy, yy], -1).view(-1, 2, 2))
    assert values[:, 0].max() < 0.35  # less than a pixel wide
    # A stroke of length l has a variance of l^2 / 12 along itself.
    assert 3.5 < values[:, 1].max() < 9.5**2 / 12 + 0.5 and values[:, 1].min() < 2
    angle = torch.atan2(2 * xy, xx - yy)[values[:, 1] > 1]
    assert angle.min() < -1.5 and angle.max() > 1.5


def test_noise_grows_with_the_light() -> None:
    dark, bright = torch.full((64, 3, 24, 24), 0.05), torch.full((64, 3, 24, 24), 0.8)
    for options, ratio, rel in (({"shot_noise": 0.1}, 4.0, 0.25), ({"noise": 0.03}, 1.0, 0.1)):
        # The same seed draws the same strengths and the same noise of unit deviation.
        deviations = [float(_changed(image, **options).std()) for image in (dark, bright)]
        assert deviations[1] == pytest.approx(ratio * deviations[0], rel=rel)


def test_clipping_loses_both_ends_of_the_range() -> None:
    ramp = torch.linspace(0, 1, 101).view(1, 1, 1, 101).expand(50, 3, 8, 101)
    clipped = _changed(ramp, clip=0.2)
    black = (clipped[:, 0, 0] < 1e-3).sum(1)
    white = (clipped[:, 0, 0] > 1 - 1e-6).sum(1)
    for count in (black, white):
        assert 15 < count.max() <= 21 and count.min() < 6
    middle = clipped[:, 0, 0, 25:75]
    assert (middle.diff(dim=1) > 0.0099).all()
