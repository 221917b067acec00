"""The assembled network: pyramid, correlation, five decoders, matchability."""

import itertools
from dataclasses import dataclass

import torch
import torch.nn.functional as F
from torch import Tensor, nn

from dgc_pose.network.config import (
    COARSEST,
    CORRELATED,
    DEVIATION,
    EPSILON,
    INPUT_SIZE,
    LEVEL_SIZES,
    MEAN,
    PASSES,
    PEAK,
    SECOND_SIZE,
    STRIDE,
    DecoderConfig,
    NetworkConfig,
)
from dgc_pose.network.correlation import consensus, match_scores, peaks, pooled_evidence
from dgc_pose.network.efficientnet import EfficientPyramid, upsample

# Initial inverse temperature of the correlation; the encoder's training learns it.
INITIAL_SCALE = 20.0


@dataclass(frozen=True)
class Prediction:
    """The maps and mask logits of a batch of pairs, coarse to fine."""

    # (B, 2, S, S), S = 15 to 240 (or h, w to 16 h, 16 w) on the target's grid: x and y in the
    # source, normalised by the configuration's align_corners
    maps: tuple[Tensor, ...]
    # (B, 1, S, S) matchability logits: five from decoders with a mask channel, one (at 240) from
    # the mask network; none without a mask, or if the mask network's level is not decoded
    logits: tuple[Tensor, ...]


class DGCNet(nn.Module):
    """DGC-Net and its variants (Melekhov et al., WACV 2019), by a `NetworkConfig`.

    Called as net(source, target) with normalised images (B, 3, 240, 240), or, with
    `config.any_shape`, of any sides that are multiples of 16. The map lies on the target's grid;
    its values are points of the source.
    """

    def __init__(self, config: NetworkConfig) -> None:
        super().__init__()
        self.config = config
        # Convolutions in bfloat16; correlations and maps stay in single precision.
        self.half_precision = False
        self.pyramid: Pyramid | EfficientPyramid
        if config.pyramid == "efficientnet-lite0":
            self.pyramid = EfficientPyramid()
        else:
            self.pyramid = Pyramid(config)
        for level in range(COARSEST, -1, -1):
            inputs = config.decoder_inputs(level)
            outputs = config.map_channels
            self.add_module(f"reg_{level}", Decoder(inputs, config.decoders[level], outputs))
        if config.matchability == "network":
            self.matchability_net = MatchabilityNet(2 * config.level_channels[0])
        scales = torch.full((len(CORRELATED),), INITIAL_SCALE)
        self.register_buffer("correlation_scales", scales, persistent=config.any_shape)

    def forward(self, source: Tensor, target: Tensor) -> Prediction:
        return self.decode(self.features(source), self.features(target))

    def features(self, image: Tensor) -> list[Tensor]:
        """Features (B, C_k, H_k, W_k) of levels 0 to 4 of a normalised image (B, 3, 16 h, 16 w).

        With `any_shape`, the features of the correlated levels at the second scale follow, the
        coarsest first, resampled to the grids of the same levels.
        """
        features = self.encode(image)
        if self.config.any_shape:
            ratio = SECOND_SIZE / INPUT_SIZE
            size = [STRIDE * max(1, round(side * ratio / STRIDE)) for side in image.shape[2:]]
            smaller = self.encode(F.interpolate(image, size, mode="bilinear", antialias=True))
            features += [
                F.interpolate(smaller[level], features[level].shape[2:], mode="bilinear")
                for level in CORRELATED
            ]
        return features

    def encode(self, image: Tensor) -> list[Tensor]:
        with self._precision(image):
            features = self.pyramid(image)
        return [feature.to(image.dtype) for feature in features]

    def coarse_features(self, image: Tensor) -> list[Tensor]:
        """Features of levels 2 to 4 (strides 4, 8 and 16) of a normalised image (B, 3, 16 h, 16 w),
        in the precision of the convolutions: bfloat16 with `half_precision`."""
        with self._precision(image):
            return self.pyramid.coarse(image)

    def decode(
        self, source: list[Tensor], target: list[Tensor], finest: int = INPUT_SIZE
    ) -> Prediction:
        """The prediction from the features of both images, as `features` returns them.

        finest: the last level decoded, by its cells a side for square images, one of LEVEL_SIZES.
        """
        states = [self.start(source, target)]
        warped = source[0]
        last = LEVEL_SIZES.index(finest)
        for level in range(COARSEST - 1, last - 1, -1):
            previous = upsample(states[-1])
            warped = self.warp(source[level], previous)
            grid = _grid(source[level])
            states.append(self.refine(level, warped, target[level], previous, grid))
        maps = tuple(state[:, :2] for state in states)
        if self.config.matchability == "decoder":
            return Prediction(maps, tuple(state[:, 2:] for state in states))
        if self.config.matchability == "network" and last == 0:
            return Prediction(maps, (self.mask(warped, target[0]),))
        return Prediction(maps, ())

    def _scales(self, features: list[Tensor]) -> list[list[Tensor]]:
        """The correlated levels, the coarsest first: at full scale, and at the second scale."""
        scales = [features[level] for level in CORRELATED], features[len(LEVEL_SIZES) :]
        return [[l2_normalise(level) for level in levels] for levels in scales]

    def start(self, source: list[Tensor], target: list[Tensor]) -> Tensor:
        """The state of level 4 from both images' features: (B, 2 or 3, h, w), the map and, with
        matchability "decoder", the mask logit. With `any_shape`, it is the peak of the evidence,
        corrected by the decoder."""
        level1 = source[COARSEST]
        level2 = target[COARSEST]
        grid = _grid(level1)
        target_grid = _grid(level2)
        if not self.config.any_shape:
            correlation = global_correlation(l2_normalise(level1), l2_normalise(level2))
            state = level1.new_zeros(len(level1), self.config.map_channels, *grid)
            return self._decode_level(COARSEST, l2_normalise(correlation.relu()), state, grid)
        scales = self.get_buffer("correlation_scales")
        evidence = pooled_evidence(self._scales(source), self._scales(target), scales)
        belief = consensus(match_scores(evidence), PASSES, grid, target_grid)
        cells, probability = peaks(belief, grid)
        points = to_normalised(cells.movedim(1, -1), grid[::-1], self.config.align_corners)
        logits = probability.clamp(*PEAK).logit()[:, None]
        state = torch.cat([points.movedim(-1, 1), logits], 1).view(len(level1), 3, *target_grid)
        return self.refine(COARSEST, self.warp(level1, state), level2, state, grid)

    def mask(self, warped: Tensor, target: Tensor) -> Tensor:
        """The mask network's logits (B, 1, H, W) from level 0: warped source and target."""
        features = torch.cat([warped, target], 1)
        with self._precision(features):
            logits = self.matchability_net(features)
        return logits.to(features.dtype)

    def refine(
        self, level: int, warped: Tensor, target: Tensor, previous: Tensor, grid: tuple[int, int]
    ) -> Tensor:
        """The state of a level, or of a part of it, from the previous state at this level's size.
        grid: rows and columns of the source at this level."""
        parts = [warped, target]
        radius = self.config.decoders[level].local_radius
        if radius is not None:
            parts.append(local_correlation(l2_normalise(warped), l2_normalise(target), radius))
        return self._decode_level(level, torch.cat(parts, 1), previous, grid)

    def _decode_level(
        self, level: int, features: Tensor, previous: Tensor, grid: tuple[int, int]
    ) -> Tensor:
        inputs = torch.cat([features, previous], 1)
        with self._precision(inputs):
            outputs = self.get_submodule(f"reg_{level}")(inputs)
        change = outputs.to(inputs.dtype)
        if not self.config.any_shape:
            return change
        # Corrections are in cells; the mask logit has no unit.
        cell = change.new_tensor([2 / grid[1], 2 / grid[0]])[:, None, None]
        return previous + torch.cat([change[:, :2] * cell, change[:, 2:]], 1)

    def warp(self, features: Tensor, previous: Tensor) -> Tensor:
        """Source features (B, C, S, S) sampled at a map (B, 2.., H, W): (B, C, H, W)."""
        grid = previous[:, :2].movedim(1, -1)
        warped = F.grid_sample(features, grid, align_corners=self.config.align_corners)
        # grid_sample drops the memory format, and operations on mixed formats are far slower.
        if features.is_contiguous(memory_format=torch.channels_last):
            return warped.contiguous(memory_format=torch.channels_last)
        return warped

    def _precision(self, like: Tensor) -> torch.autocast:
        return torch.autocast(like.device.type, torch.bfloat16, enabled=self.half_precision)


class Pyramid(nn.Module):
    """Features of an image at 240, 120, 60, 30 and 15 cells a side (paper, section 3.1), by the
    first layers of VGG-16: 3x3 convolutions with ReLU, and a max-pool at the end of each level
    except the first."""

    def __init__(self, config: NetworkConfig) -> None:
        super().__init__()
        assert not isinstance(config.pyramid, str)
        inputs = 3
        for index, level in enumerate(config.pyramid):
            layers: list[nn.Module] = []
            for channels in level:
                layers.append(nn.Conv2d(inputs, channels, 3, padding=1))
                layers.append(nn.ReLU())
                inputs = channels
            if index > 0:
                layers.append(nn.MaxPool2d(2, 2))
            self.add_module(f"level_{index}", nn.Sequential(*layers))

    def forward(self, image: Tensor) -> list[Tensor]:
        features = []
        for level in self.children():
            image = level(image)
            features.append(image)
        return features

    def coarse(self, image: Tensor) -> list[Tensor]:
        return self(image)[2:]


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


def l2_normalise(features: Tensor) -> Tensor:
    """Features (B, C, H, W) of unit length over the channels: f / sqrt(sum f^2 + 1e-6)."""
    return features / torch.sqrt(features.square().sum(1, keepdim=True) + EPSILON)


def global_correlation(source: Tensor, target: Tensor) -> Tensor:
    """Correlation of all source and target cells (paper, section 3.2): (B, h1 * w1, h2, w2),
    channel xs * h1 + ys at (yt, xt) is <source(ys, xs), target(yt, xt)>."""
    columns = source.transpose(2, 3).flatten(2)
    return torch.einsum("bcs,bcyx->bsyx", columns, target)


def local_correlation(warped: Tensor, target: Tensor, radius: int) -> Tensor:
    """Correlation of target cells with the warped source in a window around the same cell, zero
    outside: (B, (2 radius + 1)^2, H, W), <warped(y + dy, x + dx), target>, (dy, dx) row by row."""
    height, width = target.shape[2:]
    padded = F.pad(warped, (radius,) * 4)
    scores = [
        (padded[:, :, dy : dy + height, dx : dx + width] * target).sum(1)
        for dy, dx in itertools.product(range(2 * radius + 1), repeat=2)
    ]
    return torch.stack(scores, 1)


def _grid(features: Tensor) -> tuple[int, int]:
    """Rows and columns of a level's features (B, C, H, W)."""
    return features.shape[2], features.shape[3]


def normalise(images: Tensor) -> Tensor:
    """The network's input from RGB images (B, 3, H, W) in [0, 1], by ImageNet's statistics."""
    mean, deviation = (images.new_tensor(v)[:, None, None] for v in (MEAN, DEVIATION))
    return (images - mean) / deviation


def to_pixels(normalised: Tensor, size: tuple[int, int], align_corners: bool) -> Tensor:
    """Pixels of an image of `size` (width, height) from normalised coordinates (..., 2). -1 and +1
    are the centres of the outer pixels with align_corners, their outer edges without."""
    extent = normalised.new_tensor(size)
    if align_corners:
        return (normalised + 1) * (extent - 1) / 2
    return ((normalised + 1) * extent - 1) / 2


def to_normalised(pixels: Tensor, size: tuple[int, int], align_corners: bool) -> Tensor:
    """The inverse of `to_pixels`: (..., 2) pixels to normalised coordinates."""
    extent = pixels.new_tensor(size)
    if align_corners:
        return 2 * pixels / (extent - 1) - 1
    return (2 * pixels + 1) / extent - 1
