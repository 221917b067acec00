"""Random draws that depend on a run's seed and step alone, however many processes make them."""

from __future__ import annotations

import hashlib

import torch
from torch import Tensor

from dgc_pose.training.processes import process_count, rank


def seeded(*words: object) -> torch.Generator:
    """A CPU generator whose seed is a hash of the words: nothing to save for a resumed run."""
    digest = hashlib.sha256(" ".join(map(str, words)).encode()).digest()
    return torch.Generator().manual_seed(int.from_bytes(digest[:7], "big"))


class Draws:
    """Draws for a batch that the processes share: each draws for all, and keeps its own pairs.

    The values are on `device`; getting them there waits for nothing.
    """

    def __init__(self, generator: torch.Generator, device: torch.device) -> None:
        self._generator = generator
        self._device = device

    def uniform(self, batch: int, *shape: int) -> Tensor:
        """In [0, 1): (batch, *shape) for this process's pairs."""
        return self._own(torch.rand(process_count() * batch, *shape, generator=self._generator))

    def normal(self, batch: int, *shape: int) -> Tensor:
        return self._own(torch.randn(process_count() * batch, *shape, generator=self._generator))

    def integers(self, count: int, size: int) -> list[int]:
        """So many in [0, count), the same for every process."""
        values: list[int] = torch.randint(count, (size,), generator=self._generator).tolist()
        return values

    def _own(self, values: Tensor) -> Tensor:
        values = values.chunk(process_count())[rank()]
        if self._device.type == "cuda":
            # From pinned memory alone does the copy run beside the processor.
            values = values.pin_memory()
        return values.to(self._device, non_blocking=True)
