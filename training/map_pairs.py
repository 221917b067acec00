"""Batches of image pairs with their true maps, at the finest level and at coarser ones."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
import torch
from torch import Tensor

# Cells whose four central pixels map this far apart (pixels) straddle two surfaces: not valid.
_STRADDLES_PX = 6.0


class MapPairs(NamedTuple):
    """A batch of pairs with the truth; pixel (0, 0) is the centre of the top-left pixel."""

    image1: Tensor  # (B, 3, H, W) source in [0, 1]
    image2: Tensor  # (B, 3, H, W) target in [0, 1]
    map: Tensor  # (B, H, W, 2) x and y in the source of each target pixel, pixels
    valid: Tensor  # (B, H, W) bool, the target's pixel is visible in the source
    # (B, H, W) bool, `valid` is the truth; else neither map nor mask is learnt there
    known: Tensor

    def chosen(self, which: slice | Tensor) -> MapPairs:
        """Some of the pairs: a slice of the batch, or those that a (B,) bool mask selects."""
        return MapPairs(*(values[which] for values in self))


def image_arrays(images: Tensor) -> np.ndarray:
    """Images (B, 3, H, W) in [0, 1] as (B, H, W, 3) uint8."""
    return (255 * images.permute(0, 2, 3, 1)).round().byte().contiguous().cpu().numpy()


def level_truth(truth: Tensor, valid: Tensor, rows: int) -> tuple[Tensor, Tensor]:
    """The true map at a level of so many rows, (B, rows, columns, 2) pixels at the cells' centres,
    and the mask of valid cells.

    truth: (B, H, W, 2) pixels; valid: (B, H, W). The centre of a cell of s > 1 pixels lies between
    its four central pixels: its truth is their mean, valid if all are and lie on one surface.
    """
    stride = truth.shape[1] // rows
    if stride == 1:
        return truth, valid
    central = _central_pixels(truth, stride)
    spread = (central.amax(0) - central.amin(0)).amax(-1)
    whole = level_known(valid, rows)
    return central.mean(0), whole & (spread < max(_STRADDLES_PX, 2.0 * stride / 4))


def level_known(known: Tensor, rows: int) -> Tensor:
    """Cells (B, rows, columns) whose central pixels are all known, of known pixels (B, H, W)."""
    stride = known.shape[1] // rows
    return known if stride == 1 else _central_pixels(known, stride).all(0)


def _central_pixels(values: Tensor, stride: int) -> Tensor:
    """The four pixels around the cells' centres: (B, H, W, ...) to (4, B, h, w, ...)."""
    two = (stride // 2 - 1, stride // 2)
    return torch.stack([values[:, y::stride, x::stride] for y in two for x in two])
