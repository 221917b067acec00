"""Random photometric changes: exposure, colour, light across the view, blur and noise."""

from __future__ import annotations

from dataclasses import dataclass

import torch
import torch.nn.functional as F
from torch import Tensor


@dataclass(frozen=True)
class PhotometricOptions:
    """How much two views of a training pair may differ in light; each view is drawn on its own."""

    gain: float = 0.35  # exposure: exp of uniform in +- this; each channel 0.3 times as much
    gamma: float = 0.35  # exp of uniform in +- this
    contrast: float = 0.3  # 1 + uniform in +- this, about the mean
    saturation: float = 0.5  # 1 + uniform in +- this, towards grey
    shade: float = 0.4  # strength of a linear change of light across the view
    blur_share: float = 0.3  # of the views that are blurred
    blur_sigma: float = 1.2  # pixels, at most
    noise: float = 0.03  # standard deviation at most, of a range of 1


def random_photometric(
    images: Tensor, options: PhotometricOptions, generator: torch.Generator
) -> Tensor:
    """Images (B, 3, H, W) in [0, 1], each changed on its own, clamped to [0, 1]."""
    batch, _, height, width = images.shape

    def uniform(low: float, high: float, *shape: int) -> Tensor:
        values = torch.rand(batch, *shape, generator=generator)
        return (low + (high - low) * values).to(images)

    images = images * uniform(-options.gain, options.gain, 1, 1, 1).exp()
    images = images * (0.3 * uniform(-options.gain, options.gain, 3, 1, 1)).exp()
    grey = images.mean(1, keepdim=True)
    saturation = 1 + uniform(-options.saturation, options.saturation, 1, 1, 1)
    images = grey + (images - grey) * saturation
    mean = images.mean((1, 2, 3), keepdim=True)
    images = mean + (images - mean) * (1 + uniform(-options.contrast, options.contrast, 1, 1, 1))
    x = torch.linspace(-1, 1, width, device=images.device)
    y = torch.linspace(-1, 1, height, device=images.device)[:, None]
    slope = uniform(-options.shade, options.shade, 2, 1, 1)
    images = images * (1 + slope[:, 0:1] * x + slope[:, 1:2] * y).clamp(min=0.1)
    images = images.clamp(1e-4, 1) ** uniform(-options.gamma, options.gamma, 1, 1, 1).exp()
    images = _random_blur(images, uniform(0, 1), uniform(0.3, options.blur_sigma), options)
    noise = torch.randn(images.shape, generator=generator).to(images)
    return (images + noise * uniform(0, options.noise, 1, 1, 1)).clamp(0, 1)


def _random_blur(
    images: Tensor, draw: Tensor, sigma: Tensor, options: PhotometricOptions
) -> Tensor:
    """A separable Gaussian on the share of images that `draw` picks, each with its own sigma."""
    chosen = (draw < options.blur_share).nonzero()[:, 0]
    if not len(chosen):
        return images
    radius = 3
    offsets = torch.arange(-radius, radius + 1, device=images.device, dtype=images.dtype)
    kernel = torch.exp(-0.5 * (offsets / sigma[chosen, None]).square())
    kernel = (kernel / kernel.sum(1, keepdim=True)).repeat_interleave(3, 0)[:, None]
    planes = images[chosen].flatten(0, 1)[None]
    planes = F.pad(planes, (radius,) * 4, mode="reflect")
    planes = F.conv2d(planes, kernel[:, :, None], groups=planes.shape[1])
    planes = F.conv2d(planes, kernel[:, :, :, None], groups=planes.shape[1])
    blurred = images.clone()
    blurred[chosen] = planes[0].unflatten(0, (-1, 3))
    return blurred
