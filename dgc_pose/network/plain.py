"""A pyramid level as a sequence of layers: convolutions, residual blocks and pools."""

from __future__ import annotations

import torch.nn.functional as F
from torch import Tensor, nn

from dgc_pose.network.config import Pool, PyramidLevel
from dgc_pose.network.config import Residual as ResidualConfig


class Residual(nn.Module):
    """A `Residual` of the configuration: (B, C, H, W) to the same shape."""

    def __init__(self, channels: int, dilation: int, batch_norm: bool) -> None:
        super().__init__()
        self.body = nn.Sequential(
            *_convolution(channels, channels, batch_norm),
            nn.ReLU(),
            *_convolution(channels, channels, batch_norm, dilation=dilation),
        )

    def forward(self, features: Tensor) -> Tensor:
        return F.relu(features + self.body(features))


def plain_level(level: PyramidLevel, inputs: int, batch_norm: bool = False) -> nn.Sequential:
    """The layers of a level with `inputs` input channels."""
    layers: list[nn.Module] = []
    for part in level:
        if isinstance(part, Pool):
            layers.append(nn.MaxPool2d(2, 2))
            continue
        if isinstance(part, ResidualConfig):
            layers.append(Residual(part.channels, part.dilation, batch_norm))
            continue
        layers += _convolution(
            inputs, part.channels, batch_norm, part.kernel, part.stride, part.dilation
        )
        if part.relu:
            layers.append(nn.ReLU())
        inputs = part.channels
    return nn.Sequential(*layers)


def _convolution(
    inputs: int,
    outputs: int,
    batch_norm: bool,
    kernel: int = 3,
    stride: int = 1,
    dilation: int = 1,
) -> list[nn.Module]:
    padding = dilation * (kernel // 2)
    convolution = nn.Conv2d(inputs, outputs, kernel, stride, padding, dilation=dilation)
    return [convolution, nn.BatchNorm2d(outputs)] if batch_norm else [convolution]
