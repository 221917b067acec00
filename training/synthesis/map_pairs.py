"""Batches of image pairs with their true maps, at the finest level and at coarser ones."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass, field, fields, replace
from typing import Any, TypeVar

import numpy as np
import torch
from torch import Tensor

# Cells whose four central pixels map this far apart (pixels) straddle two surfaces: not valid.
_STRADDLES_PX = 6.0


Batch = TypeVar("Batch")  # a dataclass of tensors


@dataclass(frozen=True)
class MapPairs:
    """A batch of pairs with the truth; pixel (0, 0) is the centre of the top-left pixel."""

    image1: Tensor  # (B, 3, S, S) source in [0, 1]
    image2: Tensor  # (B, 3, S, S) target in [0, 1]
    map: Tensor  # (B, S, S, 2) x and y in the source of each target pixel, pixels
    valid: Tensor  # (B, S, S) bool, the target's pixel is visible in the source
    # (B, S, S) bool, `valid` is the truth; else `valid` is False and neither map nor mask is
    # learnt. Left out: the truth is known everywhere.
    known: Tensor = field(default=None)  # type: ignore[assignment]

    def __post_init__(self) -> None:
        if self.known is None:
            object.__setattr__(self, "known", torch.ones_like(self.valid))

    def to(self, device: torch.device | str) -> MapPairs:
        """The batch on another device."""
        return changed(self, lambda values: values.to(device))

    def chosen(self, which: slice | Tensor) -> MapPairs:
        """Some of the pairs: a slice of the batch, or those that a (B,) bool mask selects."""
        return changed(self, lambda values: values[which])


def combined(parts: Sequence[Batch], combine: Callable[[list[Tensor]], Tensor]) -> Batch:
    """A dataclass of the parts' tensors, each combined; other fields are the first part's."""
    first: Any = parts[0]
    names = [f.name for f in fields(first) if isinstance(getattr(first, f.name), Tensor)]
    tensors = {name: combine([getattr(part, name) for part in parts]) for name in names}
    result: Batch = replace(first, **tensors)
    return result


def changed(batch: Batch, change: Callable[[Tensor], Tensor]) -> Batch:
    """A dataclass with every tensor changed."""
    return combined([batch], lambda tensors: change(tensors[0]))


def joined(parts: Sequence[Batch]) -> Batch:
    """Several batches, one after the other."""
    return combined(parts, torch.cat)


def image_arrays(images: Tensor) -> np.ndarray:
    """Images (B, 3, H, W) in [0, 1] as (B, H, W, 3) uint8."""
    return (255 * images.permute(0, 2, 3, 1)).round().byte().contiguous().cpu().numpy()


def point_grid(x: Tensor, y: Tensor | None = None) -> Tensor:
    """Points (1, n * m, 2), row by row, of m columns `x` and n rows `y`, else `x` too."""
    return torch.stack(torch.meshgrid(x, x if y is None else y, indexing="xy"), -1).view(1, -1, 2)


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
    rows = columns = (stride // 2 - 1, stride // 2)
    return torch.stack([values[:, y::stride, x::stride] for y in rows for x in columns])
