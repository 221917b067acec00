"""The pyramid on EfficientNet-Lite0: where its cells lie."""

import pytest
import torch
from torch import nn

from dgc_pose.network.efficientnet import EfficientPyramid


@pytest.fixture
def pyramid():
    torch.manual_seed(0)
    return EfficientPyramid().eval().requires_grad_(False)


def test_features_of_a_rotated_image_lie_in_the_rotated_cells(pyramid):
    """By 180 degrees, kernels too. With odd kernels of stride 2 they would be half a cell off."""
    image = torch.randn(1, 3, 96, 64)
    upright = pyramid(image)
    for module in pyramid.modules():
        if isinstance(module, nn.Conv2d):
            module.weight.copy_(module.weight.flip(-1, -2))
    rotated = pyramid(image.flip(-1, -2))
    # Level 1 has an odd kernel of stride 2, as in dgcm-lite0, and is not matched between rotations.
    for level in (0, 2, 3, 4):
        expected = upright[level].flip(-1, -2)
        assert torch.allclose(rotated[level], expected, atol=1e-4 * expected.abs().max())
