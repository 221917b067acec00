"""The frozen encoder's features of an image in its own shape, at nearly its own resolution."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
import torch
import torch.nn.functional as F
from torch import Tensor

from dgc_pose.image import Image, resize
from dgc_pose.matching.cache import BoundedCache
from dgc_pose.network.device import multiplies_bfloat16
from dgc_pose.network.net import DGCNet
from dgc_pose.network.statistics import normalise

STRIDE = 16  # pixels of the resized image per cell of the coarsest level


@dataclass(frozen=True)
class Features:
    """Features of an image, unit length over the channels."""

    coarse: Tensor  # (C, h, w), stride 16
    middle: Tensor  # (C, 2 h, 2 w), stride 8
    fine: Tensor  # (C, 4 h, 4 w), stride 4
    size: tuple[int, int]  # (width, height) of the image they were computed from

    @property
    def nbytes(self) -> int:
        return self.coarse.nbytes + self.middle.nbytes + self.fine.nbytes


# Features by image (the object, not its pixels), quarter turns of it, and columns and rows of
# stride 16.
NativeCache = BoundedCache[tuple[Image, int, tuple[int, int]], Features]


def native_cache() -> NativeCache:
    """A cache of the default size. The images that it keeps alive count towards it."""
    return BoundedCache(lambda key, features: key[0].pixels.nbytes + features.nbytes)


def cells_at(size: tuple[int, int], scale: float) -> tuple[int, int]:
    """Columns and rows of stride 16 of an image of `size` (width, height) resized by `scale`.

    Each side becomes the nearest multiple of 16, so the actual scale differs a little.
    """
    columns, rows = (max(1, round(side * scale / STRIDE)) for side in size)
    return columns, rows


@torch.no_grad()
def native_features(net: DGCNet, pixels: np.ndarray, cells: tuple[int, int]) -> Features:
    """Features of an image (H, W, 3), uint8, at so many columns and rows of stride 16.

    Convolutions run in bfloat16 if the device multiplies it: the cosines of true matches change by
    less than a hundredth, and the pass takes half the time.
    """
    height, width = pixels.shape[:2]
    device = next(net.parameters()).device
    shrunk = torch.from_numpy(resize(pixels, (cells[0] * STRIDE, cells[1] * STRIDE)))
    planes = normalise(shrunk.to(device).permute(2, 0, 1)[None].float() / 255)
    with torch.autocast(device.type, torch.bfloat16, enabled=multiplies_bfloat16(device)):
        levels = net.pyramid.coarse(planes.contiguous(memory_format=torch.channels_last))
    # Channels last, because cells are gathered one by one later.
    fine, middle, coarse = (
        F.normalize(level.float().contiguous(memory_format=torch.channels_last), dim=1)[0]
        for level in levels
    )
    return Features(coarse, middle, fine, (width, height))
