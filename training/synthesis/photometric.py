"""Random photometric changes: light, exposure, blur of focus and motion, noise and JPEG.

Random numbers come from a CPU generator and move to the device in whole tensors, except the noise
of single pixels. The views that a change applies to are chosen on the CPU.
"""

import math

import cv2
import numpy as np
import torch
import torch.nn.functional as F
from torch import Tensor

from dgc_pose.training.synthesis.draw import Draw
from dgc_pose.training.synthesis.map_pairs import image_arrays
from dgc_pose.training.synthesis.options import PhotometricOptions

_FOCUS_RADIUS = 3  # pixels, of the focus blur's kernel


def random_photometric(
    images: Tensor, options: PhotometricOptions, generator: torch.Generator
) -> Tensor:
    """Images (B, 3, H, W) in [0, 1], each changed independently, clamped to [0, 1].

    generator: on the CPU, or on the device of the images.
    """
    draw, batch = Draw(generator, images.device, images.dtype), len(images)
    images = _change_light(images, options, draw)
    images = _filter_some(images, draw, options.blur_share, _focus_kernels(batch, options, draw))
    images = _filter_some(images, draw, options.motion_share, _motion_kernels(batch, options, draw))
    variance = draw.uniform(batch, 1, 1, 1, high=options.noise).square()
    variance = variance + draw.uniform(batch, 1, 1, 1, high=options.shot_noise).square() * images
    noise = draw.pixel_noise(images.shape)
    images = torch.addcmul(images, noise, variance.sqrt_()).clamp_(0, 1)
    low, high = options.jpeg_quality
    quality = draw.uniform(batch, low=low, high=high)
    chosen = draw.subset(batch, options.jpeg_share)
    if len(chosen):
        images[chosen] = jpeg_round_trip(images[chosen], quality[chosen])
    return images


def _change_light(images: Tensor, options: PhotometricOptions, draw: Draw) -> Tensor:
    batch, _, height, width = images.shape

    def between(limit: float, *shape: int) -> Tensor:
        return draw.uniform(batch, *shape, low=-limit, high=limit)

    images = images * between(options.gain, 1, 1, 1).exp()
    images = images * (0.3 * between(options.gain, 3, 1, 1)).exp()
    grey = images.mean(1, keepdim=True)
    images = torch.lerp(grey, images, 1 + between(options.saturation, 1, 1, 1))
    mean = images.mean((1, 2, 3), keepdim=True)
    images = torch.lerp(mean, images, 1 + between(options.contrast, 1, 1, 1))
    x = torch.linspace(-1, 1, width, device=images.device)
    y = torch.linspace(-1, 1, height, device=images.device)[:, None]
    slope = between(options.shade, 2, 1, 1)
    images = images * (1 + slope[:, 0:1] * x + slope[:, 1:2] * y).clamp(min=0.1)
    black = draw.uniform(batch, 1, 1, 1, high=options.clip)
    white = 1 - draw.uniform(batch, 1, 1, 1, high=options.clip)
    images = ((images - black) / (white - black)).clamp_(1e-4, 1)
    return images ** between(options.gamma, 1, 1, 1).exp()


def _filter_some(images: Tensor, draw: Draw, share: float, kernels: Tensor) -> Tensor:
    """Images (B, 3, H, W), about `share` of them filtered by their kernel of (B, k, k)."""
    chosen = draw.subset(len(images), share)
    if not len(chosen):
        return images
    radius = kernels.shape[-1] // 2
    filters = kernels[chosen].repeat_interleave(3, 0)[:, None]
    planes = F.pad(images[chosen].flatten(0, 1)[None], (radius,) * 4, mode="reflect")
    planes = F.conv2d(planes, filters, groups=planes.shape[1])
    return images.index_copy(0, chosen, planes[0].unflatten(0, (-1, 3)))


def _focus_kernels(batch: int, options: PhotometricOptions, draw: Draw) -> Tensor:
    """Gaussians (B, k, k) that sum to one."""
    largest = options.blur_sigma
    sigma = draw.uniform(batch, 1, low=min(0.3, largest), high=largest).clamp(min=1e-3)
    offsets = torch.arange(-_FOCUS_RADIUS, _FOCUS_RADIUS + 1, device=sigma.device)
    row = torch.exp(-0.5 * (offsets / sigma).square())
    row = row / row.sum(1, keepdim=True)
    return row[:, :, None] * row[:, None, :]


def _motion_kernels(batch: int, options: PhotometricOptions, draw: Draw) -> Tensor:
    """Straight strokes (B, k, k) about the middle, so that nothing moves; they sum to one."""
    angle = draw.uniform(batch, 1, 1, high=math.pi)
    length = draw.uniform(batch, 1, 1, low=1, high=max(1.0, options.motion_length))
    radius = math.ceil((options.motion_length + 1) / 2)
    offsets = torch.arange(-radius, radius + 1, device=length.device)
    y, x = offsets[:, None], offsets[None, :]
    along = (angle.cos() * x + angle.sin() * y).abs()
    across = (angle.cos() * y - angle.sin() * x).abs()
    stroke = ((length + 1) / 2 - along).clamp(0, 1) * (1 - across).clamp(min=0)
    return stroke / stroke.sum((1, 2), keepdim=True)


def jpeg_round_trip(images: Tensor, quality: Tensor) -> Tensor:
    """Images (B, 3, H, W) in [0, 1], RGB, written by OpenCV as JPEG of `quality` (B,), 1 to 100,
    and read."""
    decoded = []
    for pixels, percent in zip(image_arrays(images), quality.cpu().numpy(), strict=True):
        wanted = [cv2.IMWRITE_JPEG_QUALITY, round(float(percent))]
        _, data = cv2.imencode(".jpg", pixels[..., ::-1], wanted)
        decoded.append(np.asarray(cv2.imdecode(data, cv2.IMREAD_COLOR))[..., ::-1] / 255)
    return torch.from_numpy(np.stack(decoded)).permute(0, 3, 1, 2).to(images)
