"""Network configurations: fixed numbers, and the presets."""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import Literal

from dgc_pose.errors import InputError

DEFAULT_WEIGHTS = "dgcm-lite0"
INPUT_SIZE = 240  # pixels a side of both input images, if they are resized to squares
STRIDE = 16  # pixels of an input image per cell of the coarsest level
LEVEL_SIZES = (240, 120, 60, 30, 15)  # cells a side of pyramid levels 0 to 4
COARSEST = 4  # index of the level that the correlation runs on
# The correlation peak that corrections start from (ours):
CORRELATED = (4, 3)  # levels whose features are correlated, the coarsest first
SECOND_SIZE = 128  # pixels for 240: both images are also encoded at this smaller scale
LONGEST = 9.0  # ratio of the sides beyond which an image is squeezed
EPSILON = 1e-6  # under the root of a feature's length
PEAK = (0.01, 0.99)  # bounds of the peak's probability, from which the coarsest mask logit starts
PEAK_WINDOW = 2  # the peak: the cells within this distance of the highest, along each axis

# The consensus. Chosen on training photographs; factors from one half to two change little.
PASSES = 4  # rounds of belief propagation
REACH = 1.4  # source cells, standard deviation of a neighbour's match from match plus offset
WEIGHT = 0.4  # of the messages: neighbours are not independent of each other
FLOOR = 0.01  # smallest message: the neighbour may lie on another surface

MEAN = (0.485, 0.456, 0.406)  # of ImageNet's channels; normalises the network's input
DEVIATION = (0.229, 0.224, 0.225)


@dataclass(frozen=True)
class DecoderConfig:
    """A correspondence decoder: 3x3 blocks (convolution, batch norm, ReLU), then a plain 3x3."""

    channels: tuple[int, ...]  # of each block
    dilations: tuple[int, ...]  # of each block
    # Radius of the local correlation, in cells. None: no correlation; at level 4 the global one.
    local_radius: int | None = None


@dataclass(frozen=True)
class NetworkConfig:
    """Configuration of a network."""

    name: str
    # Channels of each 3x3 convolution of levels 0 to 4 (see `net.Pyramid`), or `efficientnet.py`.
    pyramid: tuple[tuple[int, ...], ...] | Literal["efficientnet-lite0"]
    decoders: tuple[DecoderConfig, ...]  # levels 0 to 4
    # False (the paper): images are resized to 240x240, and a decoder outputs the map itself; the
    # coarsest one reads a channel for each source cell. True (ours): images keep their shape, and a
    # decoder outputs a correction of the previous map, in cells; the first map is the correlation
    # peak of the CORRELATED levels at two scales.
    any_shape: bool = False
    # None: no mask (DGC-Net). "network": the paper's mask network on level 0. "decoder": a third
    # channel of every decoder, refined level by level like the map (ours).
    matchability: Literal["network", "decoder"] | None = None
    # Whether -1 and +1 are the centres of the outer pixels (True, as in the authors' weights) or
    # their outer edges (False, the same point at every level).
    align_corners: bool = True

    @property
    def level_channels(self) -> tuple[int, ...]:
        if self.pyramid == "efficientnet-lite0":
            return 16, 32, 64, 128, 128
        return tuple(channels[-1] for channels in self.pyramid)

    def input_size(self, size: tuple[int, int]) -> tuple[int, int]:
        """(width, height) that an image of `size` is resized to; with `any_shape` it has about as
        many cells as a square of 240 pixels."""
        if not self.any_shape:
            return INPUT_SIZE, INPUT_SIZE
        side = INPUT_SIZE // STRIDE
        elongation = math.sqrt(min(max(size[0] / size[1], 1 / LONGEST), LONGEST))
        return STRIDE * round(side * elongation), STRIDE * round(side / elongation)

    @property
    def map_channels(self) -> int:
        """Channels passed between decoders: x, y and, with matchability "decoder", the mask."""
        return 3 if self.matchability == "decoder" else 2

    def decoder_inputs(self, level: int) -> int:
        radius = self.decoders[level].local_radius
        if level == COARSEST and radius is None:
            return LEVEL_SIZES[COARSEST] ** 2 + self.map_channels
        local = 0 if radius is None else (2 * radius + 1) ** 2
        return 2 * self.level_channels[level] + local + self.map_channels


_VGG16 = ((64,), (64,), (128, 128), (256, 256, 256), (512, 512, 512))
_PAPER_DECODERS = (
    DecoderConfig((128, 96, 64, 32), (1, 4, 12, 16)),
    DecoderConfig((128, 96, 64, 32), (1, 4, 6, 8)),
    DecoderConfig((128, 96, 64, 32), (1, 2, 3, 4)),
    DecoderConfig((128, 128, 96, 64, 32), (1, 1, 1, 1, 1)),
    DecoderConfig((128, 128, 96, 64, 32), (1, 1, 1, 1, 1)),
)
_LITE_DECODERS = (
    DecoderConfig((32, 16), (1, 2), local_radius=2),
    DecoderConfig((48, 32, 24), (1, 2, 4), local_radius=3),
    DecoderConfig((64, 48, 32), (1, 2, 4), local_radius=3),
    DecoderConfig((128, 96, 64), (1, 1, 2), local_radius=4),
    DecoderConfig((128, 96, 64), (1, 1, 1), local_radius=4),
)

PRESETS: dict[str, NetworkConfig] = {
    "dgc": NetworkConfig("dgc", _VGG16, _PAPER_DECODERS),
    "dgcm": NetworkConfig("dgcm", _VGG16, _PAPER_DECODERS, matchability="network"),
    "dgcm-lite0": NetworkConfig(
        "dgcm-lite0",
        "efficientnet-lite0",
        _LITE_DECODERS,
        any_shape=True,
        matchability="decoder",
        align_corners=False,
    ),
}


def preset(name: str) -> NetworkConfig:
    """The preset of that name. Raises InputError, listing the names, for an unknown one."""
    if name not in PRESETS:
        raise InputError(f"no preset '{name}'; choose one of {', '.join(PRESETS)}")
    return PRESETS[name]
