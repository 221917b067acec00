"""Warped photographs: a photograph that holds its own coordinates tells the truth of a map."""

import pytest
import torch
import torch.nn.functional as F
from textures import coordinates

from dgc_pose.training.draw import Draw
from dgc_pose.training.pairs import occluded, warped_pairs
from dgc_pose.training.photos import Photos
from dgc_pose.training.views import MapPairs

WIDTH, HEIGHT = 250, 190


@pytest.fixture(scope="module")
def photos():
    """Occluders are of the same blue, and only the half of it in the second of the place."""
    first, second = (coordinates(WIDTH, HEIGHT, level) for level in (200, 100))
    return Photos.of([first], [[first, second]])


def sampled(pairs: MapPairs) -> torch.Tensor:
    """The source at the map, (B, 3, H, W)."""
    size = pairs.map.new_tensor(pairs.map.shape[2:0:-1])
    return F.grid_sample(pairs.image1, (2 * pairs.map + 1) / size - 1, align_corners=False)


@pytest.mark.parametrize("shape", [(96, 96), (64, 160)])
@pytest.mark.parametrize("light", [False, True])
def test_both_ends_of_the_map_show_one_point_of_the_photograph(photos, shape, light):
    pairs = warped_pairs(photos, 24, shape, Draw("cpu", "warp", light), light)
    assert pairs.image1.shape == (24, 3, *shape) and pairs.map.isfinite().all()
    assert not (pairs.valid & ~pairs.known).any()
    off = 255 * (sampled(pairs) - pairs.image2)[:, :2].abs().amax(1)
    share = pairs.valid.float().mean((1, 2))
    assert 0.3 < share.mean() < 0.9 and share.std() > 0.1
    # Samples between the mirrored edges, and edges of occluders, differ by more.
    assert off[pairs.valid].median() < 0.7 and (off[pairs.valid] < 3).float().mean() > 0.97
    blue = 255 * pairs.image2[:, 2].amax((1, 2))
    assert ((blue - 100).abs() < 2).any() == light


def test_occluders_are_not_visible(photos):
    views = torch.zeros(40, 64, 80, 3)
    shown, hidden = occluded(photos, views, Draw("cpu", 1), share=0.5)
    assert 0.2 < hidden.flatten(1).any(1).float().mean() < 0.8
    assert (shown[hidden][:, 2] > 0.7).all() and (shown[~hidden] == 0).all()
    assert hidden.float().mean((1, 2)).max() < 0.6
