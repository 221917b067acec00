"""The true map at the coarser levels of the network."""

from __future__ import annotations

import torch
from torch import Tensor

# Cells whose four central pixels map this far apart (pixels) straddle two surfaces: not valid.
_STRADDLES_PX = 6.0


def level_truth(truth: Tensor, valid: Tensor, cells: int) -> tuple[Tensor, Tensor]:
    """The true map at a level, (B, cells, cells, 2) pixels at the cells' centres, and the mask of
    valid cells.

    truth: (B, S, S, 2) pixels; valid: (B, S, S). The centre of a cell of s > 1 pixels lies between
    its four central pixels: its truth is their mean, valid if all are and lie on one surface.
    """
    stride = truth.shape[1] // cells
    if stride == 1:
        return truth, valid
    central = _central_pixels(truth, stride)
    spread = (central.amax(0) - central.amin(0)).amax(-1)
    whole = level_known(valid, cells)
    return central.mean(0), whole & (spread < max(_STRADDLES_PX, 2.0 * stride / 4))


def level_known(known: Tensor, cells: int) -> Tensor:
    """Cells (B, cells, cells) whose central pixels are all known, of known pixels (B, S, S)."""
    stride = known.shape[1] // cells
    return known if stride == 1 else _central_pixels(known, stride).all(0)


def _central_pixels(values: Tensor, stride: int) -> Tensor:
    """The four pixels around the cells' centres: (B, S, S, ...) to (4, B, cells, cells, ...)."""
    first = stride // 2 - 1
    corners = [
        values[:, first + dy :: stride, first + dx :: stride] for dy in (0, 1) for dx in (0, 1)
    ]
    return torch.stack(corners)
