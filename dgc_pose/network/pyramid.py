"""The feature pyramid: VGG-16's first layers for the paper's presets, a slim one for dgcm-lite."""

from __future__ import annotations

import torch.nn.functional as F
from torch import Tensor, nn
from torch.nn.utils.fusion import fuse_conv_bn_eval

from dgc_pose.network.config import NetworkConfig, Pool, PyramidLevel
from dgc_pose.network.config import Residual as ResidualConfig


class Pyramid(nn.Module):
    """Features of an image at 240, 120, 60, 30 and 15 cells a side (paper, section 3.1)."""

    def __init__(self, config: NetworkConfig) -> None:
        super().__init__()
        inputs = 3
        for index, level in enumerate(config.pyramid):
            self.add_module(f"level_{index}", _level(level, inputs, config.pyramid_batch_norm))
            inputs = config.level_channels[index]

    def forward(self, image: Tensor) -> list[Tensor]:
        """Features (B, C_k, S_k, S_k) of levels 0 to 4 of a normalised image (B, 3, S, S)."""
        features = []
        for level in self.children():
            image = level(image)
            features.append(image)
        return features


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


def _level(level: PyramidLevel, inputs: int, batch_norm: bool) -> nn.Sequential:
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


def fold_batch_norm(trained: Pyramid, plain: Pyramid) -> None:
    """Load a pyramid trained with batch norm into one without, which then gives the same features.

    VGG without batch norm does not learn from random weights; with it, folded afterwards, it does.
    """
    convolutions = [m for m in plain.modules() if isinstance(m, nn.Conv2d)]
    modules = [m for m in trained.modules() if isinstance(m, nn.Conv2d | nn.BatchNorm2d)]
    was_training = trained.training
    trained.eval()
    pairs = zip(modules[::2], modules[1::2], strict=True)
    for target, (convolution, norm) in zip(convolutions, pairs, strict=True):
        assert isinstance(convolution, nn.Conv2d) and isinstance(norm, nn.BatchNorm2d)
        target.load_state_dict(fuse_conv_bn_eval(convolution, norm).state_dict())
    trained.train(was_training)
