"""A feature pyramid with EfficientNet-Lite0 (Tan and Le, ICML 2019), to stride 16, as backbone.

It differs from the published network in two ways. The batch norms are folded into the convolutions,
in training too. The kernels of strided convolutions have an even side, 4 or 6 instead of 3 or 5.
The centre of an odd kernel of stride 2 lies half a pixel right of and below the centre of its
output cell (with TensorFlow's padding); four such layers add up to half a cell of stride 16. The
offset cancels between two upright views, but not if one is rotated or scaled.
"""

import torch.nn.functional as F
from torch import Tensor, nn

STEM_CHANNELS = 32
# For each inverted residual block: output channels, kernel, stride, and expansion of the channels.
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
LAST_BLOCKS = {2: 2, 4: 3, 10: 4}  # the last block of a stride: the pyramid level that it feeds


class EfficientPyramid(nn.Module):
    """Levels 0 and 1 are convolutions of the image. Levels 2 to 4 come from the backbone, by 1x1
    heads and a top-down path that adds each level, upsampled, to the next finer one."""

    def __init__(self) -> None:
        super().__init__()
        self.level_0 = nn.Sequential(nn.Conv2d(3, 16, 3, padding=1), nn.ReLU())
        self.level_1 = nn.Sequential(
            nn.Conv2d(16, 24, 3, 2, padding=1),
            nn.ReLU(),
            nn.Conv2d(24, 32, 3, padding=1),
            nn.ReLU(),
        )

        self.stem = nn.Sequential(_strided(3, STEM_CHANNELS, 3), nn.ReLU6())
        inputs = STEM_CHANNELS
        taken = {}
        self.blocks = nn.ModuleList()
        for index, (channels, kernel, stride, expansion) in enumerate(BLOCKS):
            self.blocks.append(InvertedResidual(inputs, channels, kernel, stride, expansion))
            inputs = channels
            if index in LAST_BLOCKS:
                taken[LAST_BLOCKS[index]] = channels

        self.head_4 = nn.Conv2d(taken[4], 128, 1)
        self.lift_4 = nn.Conv2d(taken[4], 128, 1)
        self.head_3 = nn.Conv2d(taken[3], 128, 1)
        self.merge_3 = nn.Conv2d(128, 128, 3, padding=1)
        self.lift_3 = nn.Conv2d(128, 64, 1)
        self.head_2 = nn.Conv2d(taken[2], 64, 1)
        self.merge_2 = nn.Conv2d(64, 64, 3, padding=1)

    def forward(self, image: Tensor) -> list[Tensor]:
        level0: Tensor = self.level_0(image)
        return [level0, self.level_1(level0), *self.coarse(image)]

    def coarse(self, image: Tensor) -> list[Tensor]:
        """Features of levels 2 to 4 (strides 4, 8 and 16) of an image (B, 3, 16 h, 16 w)."""
        features = self.stem(image)
        taken = []
        for index, block in enumerate(self.blocks):
            features = block(features)
            if index in LAST_BLOCKS:
                taken.append(features)
        level2, level3, level4 = taken
        mixed3 = F.relu(self.head_3(level3) + upsample(self.lift_4(level4)))
        mixed2 = F.relu(self.head_2(level2) + upsample(self.lift_3(mixed3)))
        return [self.merge_2(mixed2), self.merge_3(mixed3), self.head_4(level4)]


class InvertedResidual(nn.Module):
    """A 1x1 convolution that expands the channels, a depthwise one, and a 1x1 projection."""

    def __init__(self, inputs: int, outputs: int, kernel: int, stride: int, expansion: int) -> None:
        super().__init__()
        width = inputs * expansion
        expand = [nn.Conv2d(inputs, width, 1), nn.ReLU6()] if expansion > 1 else []
        depthwise = (
            _strided(width, width, kernel, groups=width)
            if stride == 2
            else nn.Conv2d(width, width, kernel, padding=kernel // 2, groups=width)
        )
        self.layers = nn.Sequential(*expand, depthwise, nn.ReLU6(), nn.Conv2d(width, outputs, 1))
        self.skips = stride == 1 and inputs == outputs

    def forward(self, features: Tensor) -> Tensor:
        change: Tensor = self.layers(features)
        return features + change if self.skips else change


def _strided(inputs: int, outputs: int, kernel: int, groups: int = 1) -> nn.Conv2d:
    """A convolution of stride 2, its kernel of side `kernel` + 1 centred on the output cell."""
    return nn.Conv2d(inputs, outputs, kernel + 1, 2, kernel // 2, groups=groups)


def upsample(features: Tensor) -> Tensor:
    """Features or a level's state at twice the size, bilinear, with align_corners False in every
    preset."""
    return F.interpolate(features, scale_factor=2, mode="bilinear", align_corners=False)
