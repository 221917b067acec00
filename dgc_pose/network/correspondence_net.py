"""What all networks share: the pyramid, the images that they take, and the maps that they give."""

from dataclasses import dataclass

import torch
import torch.nn.functional as F
from torch import Tensor, nn

from dgc_pose.network.config import INPUT_SIZE, STRIDE, EfficientNet, NetworkConfig
from dgc_pose.network.efficientnet import EfficientPyramid
from dgc_pose.network.pyramid import Pyramid


@dataclass(frozen=True)
class Prediction:
    """The maps and mask logits of a batch of pairs, coarse to fine."""

    # (B, 2, S, S), S = 15, 30, 60, 120, 240 (or h, w to 16 h, 16 w) on the target's grid: x and y
    # in the source, normalised by the configuration's align_corners
    maps: tuple[Tensor, ...]
    # (B, 1, S, S) matchability logits: five from decoders with a mask channel, one (at 240) from
    # the mask network; none for a network without a mask, or if its level is not decoded
    logits: tuple[Tensor, ...]


class CorrespondenceNet(nn.Module):
    """A pyramid of features and what makes dense maps of them, by a `NetworkConfig`.

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
        if isinstance(config.pyramid, EfficientNet):
            self.pyramid = EfficientPyramid(config.pyramid)
        else:
            self.pyramid = Pyramid(config)

    def forward(self, source: Tensor, target: Tensor) -> Prediction:
        sides = {side for image in (source, target) for side in image.shape[2:]}
        any_shape = self.config.any_shape
        if any(side % STRIDE for side in sides) if any_shape else sides != {INPUT_SIZE}:
            needed = f"multiples of {STRIDE}" if any_shape else str(INPUT_SIZE)
            raise ValueError(f"the sides of source and target must be {needed}, not {sides}")
        return self.decode(self.features(source), self.features(target))

    def features(self, image: Tensor) -> list[Tensor]:
        """Features (B, C_k, H_k, W_k) of levels 0 to 4 of a normalised image (B, 3, 16 h, 16 w),
        then what else `decode` needs of an image."""
        return self.encode(image)

    def decode(
        self, source: list[Tensor], target: list[Tensor], finest: int = INPUT_SIZE
    ) -> Prediction:
        """The prediction from the features of both images, as `features` gives them.

        finest: cells a side of the last level decoded, for squared images, one of LEVEL_SIZES.
        """
        raise NotImplementedError

    def encode(self, image: Tensor) -> list[Tensor]:
        """Features of levels 0 to 4 of a normalised image, and nothing else."""
        with self._precision(image):
            features = self.pyramid(image)
        return [feature.to(image.dtype) for feature in features]

    def coarse_features(self, image: Tensor) -> list[Tensor]:
        """Features of levels 2 to 4 (strides 4, 8 and 16) of a normalised image (B, 3, 16 h, 16 w),
        as the convolutions give them: bfloat16 at half precision."""
        with self._precision(image):
            return self.pyramid.coarse(image)

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
