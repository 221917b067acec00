"""A frozen network made faster: the same maps by fewer operations."""

from copy import deepcopy
from typing import TypeVar

import torch
from torch import nn
from torch.nn.utils.fusion import fuse_conv_bn_eval

Net = TypeVar("Net", bound=nn.Module)


def for_inference(net: Net) -> Net:
    """A frozen copy that gives the same maps up to rounding: batch norms folded into the
    convolutions before them, ReLUs in place, filters channels last."""
    copy = deepcopy(net).eval().requires_grad_(False)
    for module in list(copy.modules()):
        if isinstance(module, nn.Sequential):
            _fold(module)
    copy.to(memory_format=torch.channels_last)  # type: ignore[call-overload]
    return copy


def _fold(layers: nn.Sequential) -> None:
    """Fold the batch norms into identities: the names of the other layers are unchanged."""
    for index, (before, layer) in enumerate(zip(layers, list(layers)[1:], strict=False), 1):
        if isinstance(layer, nn.BatchNorm2d) and isinstance(before, nn.Conv2d):
            layers[index - 1] = fuse_conv_bn_eval(before, layer)
            layers[index] = nn.Identity()
        elif isinstance(layer, nn.ReLU):
            layer.inplace = True  # its input, a convolution's output, is not read again
