"""A feature pyramid on the body of EfficientNet-Lite0 (Tan and Le, ICML 2019), to stride 16.

Two departures. The batch norms are folded into the convolutions, once and for all. And where the
body halves the resolution its kernels have an even side, 4 or 6 for 3 or 5: an odd kernel that
steps by two lies half a pixel off the middle of the cell that it fills, to the right and below with
TensorFlow's padding, and four such steps make half a cell of stride 16. That cancels between equal
views, and not between turned or scaled ones.
"""

from __future__ import annotations

import torch
import torch.nn.functional as F
from torch import Tensor, nn

from dgc_pose.network.config import EfficientNet
from dgc_pose.network.plain import plain_level

STEM_CHANNELS = 32
# Of each inverted residual: channels, kernel, stride, and how often its input is widened.
BLOCKS = (
    (16, 3, 1, 1),
    (24, 3, 2, 6),
    (24, 3, 1, 6),
    (40, 5, 2, 6),
    (40, 5, 1, 6),
    (80, 3, 2, 6),
    (80, 3, 1, 6),
    (80, 3, 1, 6),
    (112, 5, 1, 6),
    (112, 5, 1, 6),
    (112, 5, 1, 6),
)
LAST_OF_LEVEL = {2: 2, 4: 3, 10: 4}  # block to the level whose features it leaves


class EfficientPyramid(nn.Module):
    """Features of an image at 240, 120, 60, 30 and 15 cells a side.

    Levels 0 and 1 are thin convolutions of the image; 2 to 4 are the body's, each told what the
    next coarser one knows.
    """

    def __init__(self, config: EfficientNet) -> None:
        super().__init__()
        self.level_0 = plain_level(config.fine[0], 3)
        self.level_1 = plain_level(config.fine[1], config.level_channels[0])
        self.stem = nn.Sequential(_halving(3, STEM_CHANNELS, 3), nn.ReLU6())
        inputs, taken = STEM_CHANNELS, {}
        self.blocks = nn.ModuleList()
        for index, (channels, kernel, stride, widening) in enumerate(BLOCKS):
            self.blocks.append(InvertedResidual(inputs, channels, kernel, stride, widening))
            inputs = channels
            if index in LAST_OF_LEVEL:
                taken[LAST_OF_LEVEL[index]] = channels
        width2, width3, width4 = config.channels
        self.head_4 = nn.Conv2d(taken[4], width4, 1)
        self.lift_4 = nn.Conv2d(taken[4], width3, 1)
        self.head_3 = nn.Conv2d(taken[3], width3, 1)
        self.merge_3 = nn.Conv2d(width3, width3, 3, padding=1)
        self.lift_3 = nn.Conv2d(width3, width2, 1)
        self.head_2 = nn.Conv2d(taken[2], width2, 1)
        self.merge_2 = nn.Conv2d(width2, width2, 3, padding=1)

    def forward(self, image: Tensor) -> list[Tensor]:
        """Features (B, C_k, S_k, S_k) of levels 0 to 4 of a normalised image (B, 3, S, S)."""
        level0: Tensor = self.level_0(image)
        return [level0, self.level_1(level0), *self.coarse(image)]

    def coarse(self, image: Tensor) -> list[Tensor]:
        """Levels 2 to 4 alone (strides 4, 8 and 16): (B, 3, H, W), both multiples of 16."""
        level2, level3, level4 = self.body(image)
        mixed3 = F.relu(self.head_3(level3) + _doubled(self.lift_4(level4)))
        mixed2 = F.relu(self.head_2(level2) + _doubled(self.lift_3(mixed3)))
        return [self.merge_2(mixed2), self.merge_3(mixed3), self.head_4(level4)]

    def body(self, image: Tensor) -> list[Tensor]:
        """What the body knows at strides 4, 8 and 16, before the heads."""
        features = self.stem(image)
        taken = []
        for index, block in enumerate(self.blocks):
            features = block(features)
            if index in LAST_OF_LEVEL:
                taken.append(features)
        return taken

    def thaw(self, levels: int) -> None:
        """Let the coarsest `levels` levels learn, of 5, and nothing else."""
        self.requires_grad_(False)
        finest = len(LAST_OF_LEVEL) + 2 - levels
        first = min((i + 1 for i, k in LAST_OF_LEVEL.items() if k == finest - 1), default=0)
        if levels > 0:
            self.blocks[first:].requires_grad_(True)
        for name, module in self.named_children():
            if name[-2] == "_" and int(name[-1]) >= finest:
                module.requires_grad_(True)
        if finest <= 2:
            self.stem.requires_grad_(True)


class InvertedResidual(nn.Module):
    """A 1x1 convolution that widens, one of each channel by itself, and a 1x1 that narrows."""

    def __init__(
        self, inputs: int, outputs: int, kernel: int, stride: int, widening: int
    ) -> None:
        super().__init__()
        width = inputs * widening
        widen = [nn.Conv2d(inputs, width, 1), nn.ReLU6()] if widening > 1 else []
        spread = (
            _halving(width, width, kernel, groups=width)
            if stride == 2
            else nn.Conv2d(width, width, kernel, padding=kernel // 2, groups=width)
        )
        self.layers = nn.Sequential(*widen, spread, nn.ReLU6(), nn.Conv2d(width, outputs, 1))
        self.skips = stride == 1 and inputs == outputs

    def forward(self, features: Tensor) -> Tensor:
        change: Tensor = self.layers(features)
        return features + change if self.skips else change


def centred(kernel: Tensor) -> Tensor:
    """An odd kernel (..., k, k) that steps by two as an even one (..., k + 1, k + 1).

    The mean of the kernel half a pixel too far right and below and of those too far the other ways.
    """
    return torch.stack(
        [F.pad(kernel, (dx, 1 - dx, dy, 1 - dy)) for dx in (0, 1) for dy in (0, 1)]
    ).mean(0)


def _halving(inputs: int, outputs: int, kernel: int, groups: int = 1) -> nn.Conv2d:
    """A convolution with step 2 whose kernel's middle is that of the cell: side `kernel` + 1."""
    return nn.Conv2d(inputs, outputs, kernel + 1, 2, kernel // 2, groups=groups)


def _doubled(features: Tensor) -> Tensor:
    return F.interpolate(features, scale_factor=2, mode="bilinear", align_corners=False)
