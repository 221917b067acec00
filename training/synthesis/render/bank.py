"""A bank of textures with mip levels, sampled at any points of any textures in one call."""

from __future__ import annotations

from dataclasses import dataclass, replace
from itertools import accumulate

import torch
from torch import Tensor
from torch.nn.functional import avg_pool2d

_SMALLEST_LEVEL = 4  # pixels; coarser mip levels are not made
_CHUNK = 256  # photographs reduced at a time, so that no float copy of the whole set is made


@dataclass(frozen=True)
class TextureBank:
    """N textures of one size at several mip levels, each texel packed into an int32 as 0BGR.

    A packed texel is one memory access for three channels. Level k has size // 2**k.
    """

    texels: Tensor  # (T,) int32, level after level, photo after photo, row by row
    count: int
    size: tuple[int, int]  # (width, height) of level 0
    levels: int

    @staticmethod
    def from_photos(photos: Tensor) -> TextureBank:
        """A bank on the photos' device, of (N, 3, h, w) uint8, or float in [0, 1]."""
        height, width = photos.shape[2:]
        levels = (min(height, width) // _SMALLEST_LEVEL).bit_length()
        packed: list[list[Tensor]] = [[] for _ in range(levels)]
        for chunk in photos.split(_CHUNK):
            level = chunk.float() if chunk.dtype == torch.uint8 else chunk.float() * 255
            for k in range(levels):
                level = level if k == 0 else avg_pool2d(level, 2)
                packed[k].append(_pack(level))
        texels = torch.cat([block for blocks in packed for block in blocks])
        return TextureBank(texels, len(photos), (width, height), levels)

    def to(self, device: torch.device) -> TextureBank:
        """The bank on another device."""
        return replace(self, texels=self.texels.to(device))

    def sample(self, photo: Tensor, x: Tensor, y: Tensor, footprint: Tensor) -> Tensor:
        """Bilinear colours (3, n) in [0, 1] of the texture repeated by mirroring.

        photo: (n,) int64; x, y: (n,), texels of level 0 counted from the corner of the texture;
        footprint: (n,), texels of level 0 that one sample spans, which chooses the mip level.
        """
        width, height = self.size
        level = footprint.clamp(min=1e-6).log2().round().clamp(0, self.levels - 1).int()
        starts, widths, heights = (table[level] for table in self._tables())
        left, right, u = _neighbours(_mirrored(x, width) / width, widths)
        top, bottom, v = _neighbours(_mirrored(y, height) / height, heights)
        start = starts + photo * (widths * heights)
        top, bottom = start + top * widths, start + bottom * widths
        upper = torch.lerp(self._colours(top + left), self._colours(top + right), u)
        lower = torch.lerp(self._colours(bottom + left), self._colours(bottom + right), u)
        return torch.lerp(upper, lower, v).mul_(1 / 255).to(x.dtype)

    def _tables(self) -> Tensor:
        """(3, levels) int64: the index of a level's first texel, its width and its height."""
        width, height = self.size
        sizes = [(width >> k, height >> k) for k in range(self.levels)]
        texels = [self.count * w * h for w, h in sizes]
        starts = [0, *accumulate(texels[:-1])]
        tables = torch.tensor([starts, *zip(*sizes, strict=True)])
        return tables.to(self.texels.device, non_blocking=True)

    def _colours(self, index: Tensor) -> Tensor:
        """Unpacked texels, (3, n) float32 in [0, 255]."""
        packed = self.texels.index_select(0, index)
        return torch.stack((packed & 255, (packed >> 8) & 255, packed >> 16)).float()


def _pack(images: Tensor) -> Tensor:
    values = images.round().clamp(0, 255).int()
    return (values[:, 0] | (values[:, 1] << 8) | (values[:, 2] << 16)).reshape(-1)


def _mirrored(coordinate: Tensor, size: int) -> Tensor:
    """Coordinates on an endless strip of mirrored copies, reduced to [0, size]."""
    return size - (coordinate.remainder(2 * size) - size).abs()


def _neighbours(at: Tensor, size: Tensor) -> tuple[Tensor, Tensor, Tensor]:
    """The two texels around `at`, 0 to 1 along a row of `size`, and the second one's weight."""
    texel = (at * size - 0.5).clamp(min=0)
    first = torch.minimum(texel.long(), size - 1)
    second = torch.minimum(first + 1, size - 1)
    return first, second, (texel - first).float()
