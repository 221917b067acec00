"""Random photometric changes: light, exposure, blur of focus and motion, noise and JPEG.

All random numbers but the noise of single pixels come from a CPU generator and go to the device in
whole tensors; which views a change falls on is settled on the CPU too. So nothing waits for a GPU.
"""

from __future__ import annotations

import math
from dataclasses import dataclass

import torch
import torch.nn.functional as F
from torch import Tensor

from dgc_pose.errors import InputError
from dgc_pose.synthesis.jpeg import jpeg_round_trip

_FOCUS_RADIUS = 3  # pixels, of the focus blur's kernel


@dataclass(frozen=True)
class PhotometricOptions:
    """How much two views of a training pair may differ in light; each view is drawn on its own."""

    gain: float = 0.35  # exposure: exp of uniform in +- this; each channel 0.3 times as much
    gamma: float = 0.35  # exp of uniform in +- this
    contrast: float = 0.3  # 1 + uniform in +- this, about the mean
    saturation: float = 0.5  # 1 + uniform in +- this, towards grey
    shade: float = 0.4  # strength of a linear change of light across the view
    clip: float = 0.08  # black and white points move in by at most this; beyond, detail is lost
    blur_share: float = 0.3  # of the views that are out of focus
    blur_sigma: float = 1.2  # pixels, at most
    motion_share: float = 0.15  # of the views that the camera's motion blurs
    motion_length: float = 7.0  # pixels, at most, along a line of any direction
    noise: float = 0.03  # standard deviation at most, of a range of 1, whatever the light
    shot_noise: float = 0.03  # the same at white, growing with the square root of the light
    jpeg_share: float = 0.3  # of the views
    jpeg_quality: tuple[float, float] = (25.0, 95.0)  # as libjpeg counts

    def __post_init__(self) -> None:
        for name in ("blur_share", "motion_share", "jpeg_share"):
            if not 0 <= getattr(self, name) <= 1:
                raise InputError(f"{name} must be a share of one, not {getattr(self, name)}")
        if not 0 <= self.clip < 0.5:
            raise InputError(f"clip must lie in [0, 0.5), not {self.clip}")
        if not 1 <= self.jpeg_quality[0] <= self.jpeg_quality[1] <= 100:
            raise InputError(f"jpeg_quality must be two of 1 to 100, not {self.jpeg_quality}")


def random_photometric(
    images: Tensor, options: PhotometricOptions, generator: torch.Generator
) -> Tensor:
    """Images (B, 3, H, W) in [0, 1], each changed on its own, clamped to [0, 1].

    generator: on the CPU, or on the device of the images.
    """
    draw = _Draw(images, generator)
    images = _change_light(images, options, draw)
    images = _change_some(images, draw, options.blur_share, _focus_kernels(options, draw))
    images = _change_some(images, draw, options.motion_share, _motion_kernels(options, draw))
    variance = draw.uniform(0, options.noise, 1, 1, 1).square()
    variance = variance + draw.uniform(0, options.shot_noise, 1, 1, 1).square() * images
    images = torch.addcmul(images, draw.pixels(), variance.sqrt_()).clamp_(0, 1)
    quality = draw.uniform(*options.jpeg_quality)
    chosen = draw.some(options.jpeg_share)
    if len(chosen):
        images[chosen] = jpeg_round_trip(images[chosen], quality[chosen])
    return images


class _Draw:
    """Random numbers for a batch of images, on their device."""

    def __init__(self, images: Tensor, generator: torch.Generator) -> None:
        self._images = images
        self._generator = generator

    def uniform(self, low: float, high: float, *shape: int) -> Tensor:
        return low + (high - low) * self._move(self._rand(*shape))

    def some(self, share: float) -> Tensor:
        """The indices of about so many of the images."""
        return self._move((self._rand() < share).nonzero()[:, 0])

    def pixels(self) -> Tensor:
        """Standard normal, of the images' shape, drawn on their device."""
        generator = self._generator
        if generator.device != self._images.device:
            seed = int(torch.randint(2**62, (), generator=generator))
            generator = torch.Generator(self._images.device).manual_seed(seed)
        return torch.randn(
            self._images.shape,
            generator=generator,
            device=self._images.device,
            dtype=self._images.dtype,
        )

    def _rand(self, *shape: int) -> Tensor:
        size = (len(self._images), *shape)
        return torch.rand(size, generator=self._generator, device=self._generator.device)

    def _move(self, values: Tensor) -> Tensor:
        # Pageable memory is copied before the call returns, so that not waiting is safe.
        dtype = self._images.dtype if values.is_floating_point() else values.dtype
        return values.to(self._images.device, dtype, non_blocking=True)


def _change_light(images: Tensor, options: PhotometricOptions, draw: _Draw) -> Tensor:
    height, width = images.shape[2:]
    images = images * draw.uniform(-options.gain, options.gain, 1, 1, 1).exp()
    images = images * (0.3 * draw.uniform(-options.gain, options.gain, 3, 1, 1)).exp()
    grey = images.mean(1, keepdim=True)
    saturation = 1 + draw.uniform(-options.saturation, options.saturation, 1, 1, 1)
    images = torch.lerp(grey, images, saturation)
    mean = images.mean((1, 2, 3), keepdim=True)
    contrast = 1 + draw.uniform(-options.contrast, options.contrast, 1, 1, 1)
    images = torch.lerp(mean, images, contrast)
    x = torch.linspace(-1, 1, width, device=images.device)
    y = torch.linspace(-1, 1, height, device=images.device)[:, None]
    slope = draw.uniform(-options.shade, options.shade, 2, 1, 1)
    images = images * (1 + slope[:, 0:1] * x + slope[:, 1:2] * y).clamp(min=0.1)
    black = draw.uniform(0, options.clip, 1, 1, 1)
    white = 1 - draw.uniform(0, options.clip, 1, 1, 1)
    images = ((images - black) / (white - black)).clamp_(1e-4, 1)
    return images ** draw.uniform(-options.gamma, options.gamma, 1, 1, 1).exp()


def _change_some(images: Tensor, draw: _Draw, share: float, kernels: Tensor) -> Tensor:
    """Images (B, 3, H, W), about `share` of them filtered by their kernel of (B, k, k)."""
    chosen = draw.some(share)
    if not len(chosen):
        return images
    radius = kernels.shape[-1] // 2
    filters = kernels[chosen].repeat_interleave(3, 0)[:, None]
    planes = F.pad(images[chosen].flatten(0, 1)[None], (radius,) * 4, mode="reflect")
    planes = F.conv2d(planes, filters, groups=planes.shape[1])
    return images.index_copy(0, chosen, planes[0].unflatten(0, (-1, 3)))


def _focus_kernels(options: PhotometricOptions, draw: _Draw) -> Tensor:
    """Gaussians (B, k, k) that sum to one."""
    sigma = draw.uniform(min(0.3, options.blur_sigma), options.blur_sigma, 1).clamp(min=1e-3)
    offsets = torch.arange(-_FOCUS_RADIUS, _FOCUS_RADIUS + 1, device=sigma.device)
    row = torch.exp(-0.5 * (offsets / sigma).square())
    row = row / row.sum(1, keepdim=True)
    return row[:, :, None] * row[:, None, :]


def _motion_kernels(options: PhotometricOptions, draw: _Draw) -> Tensor:
    """Straight strokes (B, k, k) about the middle, so that nothing moves; they sum to one."""
    angle = draw.uniform(0, math.pi, 1, 1)
    length = draw.uniform(1, max(1.0, options.motion_length), 1, 1)
    radius = math.ceil((options.motion_length + 1) / 2)
    offsets = torch.arange(-radius, radius + 1, device=length.device)
    y, x = offsets[:, None], offsets[None, :]
    along = (angle.cos() * x + angle.sin() * y).abs()
    across = (angle.cos() * y - angle.sin() * x).abs()
    stroke = ((length + 1) / 2 - along).clamp(0, 1) * (1 - across).clamp(min=0)
    return stroke / stroke.sum((1, 2), keepdim=True)
