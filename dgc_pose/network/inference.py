"""A frozen network made fast: the same answers, from fewer and quicker passes over the features."""

from __future__ import annotations

from copy import deepcopy

import torch
from torch import nn
from torch.nn.utils.fusion import fuse_conv_bn_eval

from dgc_pose.network.net import DGCNet


def for_inference(net: DGCNet) -> DGCNet:
    """A frozen copy of a network, which gives the same maps but for rounding.

    Batch norms are folded into the convolutions before them, ReLUs work in place, and filters lie
    channels last.
    """
    copy = deepcopy(net).eval().requires_grad_(False)
    for module in list(copy.modules()):
        if isinstance(module, nn.Sequential):
            _fold(module)
    copy.to(memory_format=torch.channels_last)  # type: ignore[call-overload]
    return copy


def _fold(layers: nn.Sequential) -> None:
    """Fold the batch norms; their places, and so the names of the other layers, stay."""
    for index, (before, layer) in enumerate(zip(layers, list(layers)[1:], strict=False), 1):
        if isinstance(layer, nn.BatchNorm2d) and isinstance(before, nn.Conv2d):
            layers[index - 1] = fuse_conv_bn_eval(before, layer)
            layers[index] = nn.Identity()
        elif isinstance(layer, nn.ReLU):
            layer.inplace = True  # what it takes is a convolution's, which no one else reads
