"""Correspondence decoders and the mask network: blocks of convolution, batch norm and ReLU."""

from __future__ import annotations

from torch import Tensor, nn

from dgc_pose.network.config import DecoderConfig


def _block(inputs: int, outputs: int, dilation: int) -> nn.Sequential:
    return nn.Sequential(
        nn.Conv2d(inputs, outputs, 3, padding=dilation, dilation=dilation),
        nn.BatchNorm2d(outputs),
        nn.ReLU(),
    )


class Decoder(nn.Module):
    """One correspondence decoder (paper, section 3.3): (B, inputs, S, S) to (B, outputs, S, S)."""

    def __init__(self, inputs: int, config: DecoderConfig, outputs: int) -> None:
        super().__init__()
        for index, (channels, dilation) in enumerate(
            zip(config.channels, config.dilations, strict=True)
        ):
            self.add_module(f"conv{index}", _block(inputs, channels, dilation))
            inputs = channels
        self.final = nn.Conv2d(inputs, outputs, 3, padding=1)

    def forward(self, features: Tensor) -> Tensor:
        for module in self.children():
            features = module(features)
        return features


class MatchabilityNet(nn.Module):
    """The paper's mask network (section 3.4): (B, inputs, S, S) to logits (B, 1, S, S)."""

    def __init__(self, inputs: int, channels: tuple[int, ...] = (64, 32, 16)) -> None:
        super().__init__()
        for index, outputs in enumerate(channels):
            self.add_module(f"conv{index}", _block(inputs, outputs, 1))
            inputs = outputs
        self.conv3 = nn.Conv2d(inputs, 1, 1)

    def forward(self, features: Tensor) -> Tensor:
        for module in self.children():
            features = module(features)
        return features
