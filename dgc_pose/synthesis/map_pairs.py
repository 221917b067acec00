"""Batches of image pairs with their true maps."""

from __future__ import annotations

from dataclasses import dataclass, field

import torch
from torch import Tensor

from dgc_pose.synthesis.batches import changed


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
