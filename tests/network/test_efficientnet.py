"""The pyramid on EfficientNet-Lite0: where its cells lie, shapes, ImageNet weights."""

import pytest
import torch
import torch.nn.functional as F
from torch import Tensor, nn

from dgc_pose.network.efficientnet import BLOCKS, EfficientPyramid
from dgc_pose.network.net import normalise
from dgc_pose.training.initialise import even_kernel, load_backbone


@pytest.fixture
def pyramid() -> EfficientPyramid:
    torch.manual_seed(0)
    return EfficientPyramid().eval().requires_grad_(False)


def test_features_of_a_rotated_image_lie_in_the_rotated_cells(pyramid: EfficientPyramid) -> None:
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


def test_an_even_kernel_is_the_mean_of_the_four_shifts() -> None:
    image, kernel = torch.randn(1, 1, 16, 16), torch.randn(1, 1, 3, 3)
    even = F.conv2d(image, even_kernel(kernel), stride=2)
    shifted = [F.conv2d(image[..., y:, x:], kernel, stride=2) for y in (0, 1) for x in (0, 1)]
    expected = sum((s[..., :7, :7] for s in shifted), torch.zeros(1, 1, 7, 7)) / 4
    assert torch.allclose(even, expected, atol=1e-5)


def _checkpoint() -> dict[str, Tensor]:
    """Random weights by the names of efficientnet-lite-pytorch."""
    state: dict[str, Tensor] = {}

    def norm(name: str, channels: int) -> None:
        state[name + ".weight"] = 0.5 + torch.rand(channels)
        state[name + ".bias"] = torch.randn(channels)
        state[name + ".running_mean"] = 0.1 * torch.randn(channels)
        state[name + ".running_var"] = 0.5 + torch.rand(channels)

    state["_conv_stem.weight"] = 0.3 * torch.randn(32, 3, 3, 3)
    norm("_bn0", 32)
    inputs = 32
    for index, (channels, kernel, _, expansion) in enumerate(BLOCKS):
        prefix, width = f"_blocks.{index}.", inputs * expansion
        if expansion > 1:
            state[prefix + "_expand_conv.weight"] = torch.randn(width, inputs, 1, 1) / inputs**0.5
            norm(prefix + "_bn0", width)
        state[prefix + "_depthwise_conv.weight"] = torch.randn(width, 1, kernel, kernel) / kernel
        norm(prefix + "_bn1", width)
        state[prefix + "_project_conv.weight"] = torch.randn(channels, width, 1, 1) / width**0.5
        norm(prefix + "_bn2", channels)
        inputs = channels
    return state


def test_a_checkpoint_is_loaded_with_its_norms_folded(pyramid: EfficientPyramid) -> None:
    """Stem and a block against the same layers one by one; the stem on uniform images."""
    state = _checkpoint()
    smooth = F.interpolate(3 * torch.randn(8, 3, 2, 2), (64, 64), mode="bilinear")
    load_backbone(pyramid, state, smooth)

    def norm(features: Tensor, name: str) -> Tensor:
        scale, shift, mean, var = (
            state[f"{name}.{k}"] for k in ("weight", "bias", "running_mean", "running_var")
        )
        return F.batch_norm(features, mean, var, scale, shift, eps=1e-3)

    flat = torch.rand(4, 3, 1, 1).expand(-1, -1, 8, 8)
    wanted = norm(F.conv2d((255 * flat - 127) / 128, state["_conv_stem.weight"]), "_bn0")
    found = pyramid.stem[0](normalise(flat))[..., 1:-1, 1:-1]
    assert (found - wanted[..., :2, :2]).abs().mean() < 0.05 * wanted.abs().mean()

    block, prefix = pyramid.blocks[2], "_blocks.2."
    features = torch.randn(1, 24, 9, 9)
    inner = norm(F.conv2d(features, state[prefix + "_expand_conv.weight"]), prefix + "_bn0")
    inner = F.conv2d(
        inner.clamp(0, 6), state[prefix + "_depthwise_conv.weight"], padding=1, groups=144
    )
    inner = norm(inner, prefix + "_bn1").clamp(0, 6)
    inner = norm(F.conv2d(inner, state[prefix + "_project_conv.weight"]), prefix + "_bn2")
    assert torch.allclose(block(features), features + inner, atol=1e-3)
