"""Seeded random draws on the device that uses them, and random light for views."""

import hashlib
import math
import random
from collections.abc import Sequence
from typing import TypeVar

import torch
import torch.nn.functional as F
from torch import Tensor

T = TypeVar("T")
_RADIUS = 3  # of a blur's kernel, pixels


class Draw:
    """Random tensors on a device. The seed is a hash of words, so that a resumed run has no random
    state to restore.

    The same words give the same numbers on the same kind of device.
    """

    def __init__(self, device: torch.device | str, *words: object) -> None:
        digest = hashlib.sha256(" ".join(map(str, words)).encode()).digest()
        seed = int.from_bytes(digest[:7], "big")
        self.device = torch.device(device)
        self._generator = torch.Generator(self.device).manual_seed(seed)
        self._random = random.Random(seed)  # on the CPU, without waiting for the GPU

    def uniform(self, *shape: int, low: float = 0.0, high: float = 1.0) -> Tensor:
        numbers = torch.rand(shape, generator=self._generator, device=self.device)
        return low + (high - low) * numbers

    def log_uniform(self, *shape: int, low: float, high: float) -> Tensor:
        return self.uniform(*shape, low=math.log(low), high=math.log(high)).exp()

    def normal(self, *shape: int) -> Tensor:
        return torch.randn(shape, generator=self._generator, device=self.device)

    def integers(self, *shape: int, count: int) -> Tensor:
        """int64 in [0, count)."""
        return torch.randint(count, shape, generator=self._generator, device=self.device)

    def chance(self, *shape: int, share: float) -> Tensor:
        """True with probability `share`."""
        return self.uniform(*shape) < share

    def choice(self, values: Sequence[T]) -> T:
        """One of the values, chosen on the CPU."""
        return self._random.choice(values)


def other_light(images: Tensor, draw: Draw) -> Tensor:
    """Give each view (B, 3, H, W), in [0, 1], random exposure, blur, resolution and noise; the
    result is in [0, 1]."""
    count = len(images)
    images = _exposed(images, draw)
    kernels = _kernels(count, draw)[:, None].expand(-1, 3, -1, -1).reshape(3 * count, 1, 7, 7)
    padded = F.pad(images.flatten(0, 1)[None], (_RADIUS,) * 4, mode="reflect")
    images = F.conv2d(padded, kernels, groups=3 * count)[0].view_as(images)
    small = F.interpolate(F.avg_pool2d(images, 2), images.shape[2:], mode="bilinear")
    images = torch.where(draw.chance(count, 1, 1, 1, share=0.12), small, images)
    read, shot = (draw.uniform(count, 1, 1, 1, high=0.035) for _ in range(2))
    deviation = (read**2 + shot**2 * images.clamp(min=0)).sqrt()
    images = images + deviation * draw.normal(*images.shape)
    steps = torch.where(draw.chance(count, 1, 1, 1, share=0.2), 24.0, 255.0)
    return ((images * steps).round() / steps).clamp(0, 1)


def _exposed(images: Tensor, draw: Draw) -> Tensor:
    count, _, height, width = images.shape

    def between(limit: float, *shape: int) -> Tensor:
        return draw.uniform(count, *shape, low=-limit, high=limit)

    images = images * between(0.4, 1, 1, 1).exp() * between(0.13, 3, 1, 1).exp()
    grey = images.mean(1, keepdim=True)
    colour = 1 + between(0.6, 1, 1, 1)
    colour = torch.where(draw.chance(count, 1, 1, 1, share=0.05), 0, colour)
    images = torch.lerp(grey, images, colour)
    images = torch.lerp(images.mean((1, 2, 3), keepdim=True), images, 1 + between(0.35, 1, 1, 1))
    x = torch.linspace(-1, 1, width, device=images.device)
    y = torch.linspace(-1, 1, height, device=images.device)[:, None]
    slope = between(0.4, 2, 1, 1)
    images = images * (1 + slope[:, :1] * x + slope[:, 1:] * y).clamp(min=0.1)
    black, white = (draw.uniform(count, 1, 1, 1, high=0.08) for _ in range(2))
    images = ((images - black) / (1 - white - black)).clamp(1e-4, 1)
    return images ** between(0.45, 1, 1, 1).exp()


def _kernels(count: int, draw: Draw) -> Tensor:
    """Blur kernels (B, 7, 7) that sum to one: defocus, a stroke through the middle, or no blur."""
    offsets = torch.arange(-_RADIUS, _RADIUS + 1, device=draw.device)
    x = offsets
    y = offsets[:, None]
    sigma = draw.uniform(count, 1, 1, low=0.3, high=1.4)
    focus = torch.exp(-(x**2 + y**2) / (2 * sigma**2))
    angle = draw.uniform(count, 1, 1, high=math.pi)
    along = (angle.cos() * x + angle.sin() * y).abs()
    across = (angle.cos() * y - angle.sin() * x).abs()
    length = draw.uniform(count, 1, 1, low=1, high=6)
    stroke = ((length + 1) / 2 - along).clamp(0, 1) * (1 - across).clamp(min=0)
    none = ((x == 0) & (y == 0)).float()
    kind = draw.uniform(count, 1, 1)
    kernels = torch.where(kind < 0.3, focus, torch.where(kind < 0.42, stroke, none))
    return kernels / kernels.sum((1, 2), keepdim=True)
