"""Seeded random draws, independent of the device."""

import hashlib
import math
from collections.abc import Callable
from functools import partial

import torch
from torch import Tensor

_CPU = torch.device("cpu")


def seeded(*words: object) -> torch.Generator:
    """A CPU generator whose seed is a hash of the words: a resumed run has no state to restore."""
    digest = hashlib.sha256(" ".join(map(str, words)).encode()).digest()
    return torch.Generator().manual_seed(int.from_bytes(digest[:7], "big"))


class Draw:
    """Random tensors of any shape. The numbers are drawn on the generator's device and then moved
    to `device` without waiting, so that a CPU generator gives the same numbers for every device.
    """

    def __init__(
        self,
        generator: torch.Generator,
        device: torch.device = _CPU,
        dtype: torch.dtype = torch.float32,
    ) -> None:
        self._generator = generator
        self._device = device
        self._dtype = dtype

    def uniform(self, *shape: int, low: float = 0.0, high: float = 1.0) -> Tensor:
        return low + (high - low) * self._drawn(torch.rand, shape)

    def log_uniform(self, *shape: int, low: float, high: float) -> Tensor:
        return self.uniform(*shape, low=math.log(low), high=math.log(high)).exp()

    def normal(self, *shape: int) -> Tensor:
        """Standard normal."""
        return self._drawn(torch.randn, shape)

    def integers(self, *shape: int, count: int) -> Tensor:
        """In [0, count), int64."""
        return self._drawn(partial(torch.randint, count), shape)

    def chance(self, *shape: int, share: float) -> Tensor:
        """True with probability `share`."""
        return self.uniform(*shape) < share

    def subset(self, count: int, share: float) -> Tensor:
        """Indices (n,) int64 of about a `share` of `count` rows, chosen on the generator's device:
        how many there are is known without waiting for a GPU."""
        values = torch.rand(count, generator=self._generator, device=self._generator.device)
        return self._move((values < share).nonzero()[:, 0])

    def directions(self, *shape: int) -> Tensor:
        """Unit vectors (*shape, 3), uniform on the sphere."""
        return torch.nn.functional.normalize(self.normal(*shape, 3), dim=-1)

    def pixel_noise(self, shape: torch.Size) -> Tensor:
        """Standard normal, drawn on `device` itself: too many numbers to move."""
        generator = self._generator
        if generator.device != self._device:
            seed = int(torch.randint(2**62, (), generator=generator))
            generator = torch.Generator(self._device).manual_seed(seed)
        return torch.randn(shape, generator=generator, device=self._device, dtype=self._dtype)

    def numbers(self, size: int, count: int) -> list[int]:
        """`size` whole numbers in [0, count), for the processor."""
        values: list[int] = torch.randint(count, (size,), generator=self._generator).tolist()
        return values

    def _drawn(self, draw: Callable[..., Tensor], shape: tuple[int, ...]) -> Tensor:
        return self._move(draw(shape, generator=self._generator, device=self._generator.device))

    def _move(self, values: Tensor) -> Tensor:
        if self._device.type == "cuda" and values.device.type == "cpu":
            values = values.pin_memory()  # only from there does a copy run beside the processor
        dtype = self._dtype if values.is_floating_point() else values.dtype
        return values.to(self._device, dtype, non_blocking=True)
