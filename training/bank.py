"""Images of any size in one row on the device, sampled at any points of any of them."""

from __future__ import annotations

import math
from collections.abc import Iterable
from dataclasses import dataclass

import cv2
import numpy as np
import torch
from torch import Tensor

LEVELS = 4  # of the mip pyramid: the image, and three halvings
_SHARPNESS = 1.2  # a level is left when its texels are this much smaller than a sample


@dataclass(frozen=True)
class ImageBank:
    """N images with their mip levels."""

    texels: Tensor  # (T,) int32, R + 2^8 G + 2^16 B
    start: Tensor  # (N, LEVELS) int64, the first texel of a level
    sizes: Tensor  # (N, LEVELS, 2) int64, width and height

    @classmethod
    def of(cls, images: Iterable[np.ndarray], device: torch.device | str = "cpu") -> ImageBank:
        """The bank of images (h, w, 3) uint8, RGB."""
        levels, sizes = [], []
        for image in images:
            for _ in range(LEVELS):
                wide = image.astype(np.int32)
                levels.append((wide[..., 0] | wide[..., 1] << 8 | wide[..., 2] << 16).ravel())
                sizes.append(image.shape[1::-1])
                half = [max(1, (side + 1) // 2) for side in sizes[-1]]
                image = cv2.resize(image, half, interpolation=cv2.INTER_AREA)
        start = np.cumsum([0, *(len(level) for level in levels[:-1])]).reshape(-1, LEVELS)
        table = torch.tensor(sizes).view(-1, LEVELS, 2)
        parts = torch.from_numpy(np.concatenate(levels)), torch.from_numpy(start), table
        return cls(*(part.to(device) for part in parts))

    def size(self, image: Tensor) -> Tensor:
        """Width and height (..., 2) float of images (...) int64."""
        return self.sizes[image, 0].float()

    def sample(self, image: Tensor, points: Tensor, spacing: Tensor) -> Tensor:
        """Bilinear colours (..., 3) in [0, 1] at points (..., 2), pixels; mirrored at the edges.

        image: (...) int64; spacing: (...), the pixels between two samples, which choose the mip
        level. Both broadcast with the points.
        """
        level = (_SHARPNESS * spacing).clamp(min=1).log2().long().clamp(max=LEVELS - 1)
        start, size = self.start[image, level], self.sizes[image, level]
        place = (points + 0.5) / self.sizes[image, 0]
        mirrored = 1 - (place.remainder(2) - 1).abs()  # on an endless row of mirrored copies
        inside = torch.minimum((mirrored * size - 0.5).clamp(min=0), size - 1)
        first = inside.long()
        u, v = (inside - first).unsqueeze(-2).unbind(-1)
        left, top = first.unbind(-1)
        right, bottom = torch.minimum(first + 1, size - 1).unbind(-1)
        upper, lower = start + top * size[..., 0], start + bottom * size[..., 0]
        above = torch.lerp(self._colours(upper + left), self._colours(upper + right), u)
        below = torch.lerp(self._colours(lower + left), self._colours(lower + right), u)
        return torch.lerp(above, below, v) / 255

    def view(self, image: Tensor, points: Tensor) -> Tensor:
        """Views (B, H, W, 3) of images (B,) at points (B, H, W, 2), pixels, each about as far from
        the next."""
        return self.sample(image[:, None, None], points, spacing(points))

    def _colours(self, index: Tensor) -> Tensor:
        """Texels, unpacked: (..., 3) float32 in [0, 255]."""
        packed = self.texels[index]
        return torch.stack([packed & 255, packed >> 8 & 255, packed >> 16], -1).float()


def spacing(points: Tensor) -> Tensor:
    """The mean distance (B, 1, 1) of neighbours among points (B, H, W, 2)."""
    steps = points[:, 1:, 1:] - points[:, :-1, :-1]
    return steps.norm(dim=-1).mean((1, 2))[:, None, None] / math.sqrt(2)
