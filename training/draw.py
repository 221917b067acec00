"""Seeded random draws on the device that uses them."""

import hashlib
import math
import random
from collections.abc import Sequence
from typing import TypeVar

import torch
from torch import Tensor

T = TypeVar("T")


class Draw:
    """Random tensors on a device; the seed is a hash of words, so that a resumed run has no state
    to restore.

    The same words give the same numbers on the same kind of device.
    """

    def __init__(self, device: torch.device | str, *words: object) -> None:
        digest = hashlib.sha256(" ".join(map(str, words)).encode()).digest()
        seed = int.from_bytes(digest[:7], "big")
        self.device = torch.device(device)
        self._generator = torch.Generator(self.device).manual_seed(seed)
        self._random = random.Random(seed)  # of the processor, which waits for no GPU

    def uniform(self, *shape: int, low: float = 0.0, high: float = 1.0) -> Tensor:
        numbers = torch.rand(shape, generator=self._generator, device=self.device)
        return low + (high - low) * numbers

    def log_uniform(self, *shape: int, low: float, high: float) -> Tensor:
        return self.uniform(*shape, low=math.log(low), high=math.log(high)).exp()

    def normal(self, *shape: int) -> Tensor:
        """Standard normal."""
        return torch.randn(shape, generator=self._generator, device=self.device)

    def integers(self, *shape: int, count: int) -> Tensor:
        """In [0, count), int64."""
        return torch.randint(count, shape, generator=self._generator, device=self.device)

    def chance(self, *shape: int, share: float) -> Tensor:
        """True with probability `share`."""
        return self.uniform(*shape) < share

    def choice(self, values: Sequence[T]) -> T:
        """One of the values, chosen on the processor."""
        return self._random.choice(values)
