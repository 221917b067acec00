"""Random tensors of one generator: the same numbers whatever device they are used on."""

from __future__ import annotations

import math

import torch
from torch import Tensor


class Draw:
    """Draws on the generator's device and hands the numbers over to `device`."""

    def __init__(
        self,
        generator: torch.Generator,
        device: torch.device,
        dtype: torch.dtype = torch.float32,
    ) -> None:
        self._generator = generator
        self._device = device
        self._dtype = dtype

    def uniform(self, *shape: int, low: float = 0.0, high: float = 1.0) -> Tensor:
        values = torch.rand(shape, generator=self._generator, device=self._generator.device)
        return low + (high - low) * self._move(values)

    def log_uniform(self, *shape: int, low: float, high: float) -> Tensor:
        return self.uniform(*shape, low=math.log(low), high=math.log(high)).exp()

    def normal(self, *shape: int) -> Tensor:
        values = torch.randn(shape, generator=self._generator, device=self._generator.device)
        return self._move(values)

    def integers(self, *shape: int, count: int) -> Tensor:
        """In [0, count), int64."""
        device = self._generator.device
        values = torch.randint(count, shape, generator=self._generator, device=device)
        return values.to(self._device, non_blocking=True)

    def chance(self, *shape: int, share: float) -> Tensor:
        """True with probability `share`."""
        return self.uniform(*shape) < share

    def directions(self, *shape: int) -> Tensor:
        """Unit vectors (*shape, 3), uniform on the sphere."""
        return torch.nn.functional.normalize(self.normal(*shape, 3), dim=-1)

    def _move(self, values: Tensor) -> Tensor:
        # From pageable memory the copy is taken before the call returns: not to wait is safe.
        return values.to(self._device, self._dtype, non_blocking=True)
