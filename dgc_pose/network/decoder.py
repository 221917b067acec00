"""Correspondence decoders and the mask network: blocks of convolution, batch norm and ReLU."""

from torch import nn

from dgc_pose.network.config import DecoderConfig


class Decoder(nn.Sequential):
    """One correspondence decoder (paper, section 3.3): (B, inputs, S, S) to (B, outputs, S, S)."""

    def __init__(self, inputs: int, config: DecoderConfig, outputs: int) -> None:
        super().__init__()
        for index, dilation in enumerate(config.dilations):
            channels = config.channels[index]
            self.add_module(f"conv{index}", _block(inputs, channels, dilation))
            inputs = channels
        self.final = nn.Conv2d(inputs, outputs, 3, padding=1)


class MatchabilityNet(nn.Sequential):
    """The paper's mask network (section 3.4): (B, inputs, S, S) to logits (B, 1, S, S)."""

    def __init__(self, inputs: int) -> None:
        super().__init__()
        self.conv0 = _block(inputs, 64)
        self.conv1 = _block(64, 32)
        self.conv2 = _block(32, 16)
        self.conv3 = nn.Conv2d(16, 1, 1)


def _block(inputs: int, outputs: int, dilation: int = 1) -> nn.Sequential:
    return nn.Sequential(
        nn.Conv2d(inputs, outputs, 3, padding=dilation, dilation=dilation),
        nn.BatchNorm2d(outputs),
        nn.ReLU(),
    )
