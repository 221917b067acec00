"""Random photometric changes: light, exposure, blur of focus and motion, noise and JPEG.

Random numbers come from a CPU generator and move to the device in whole tensors, except the noise
of single pixels. The views that a change applies to are chosen on the CPU: nothing waits for a GPU.
"""

import math

import numpy as np
import torch
import torch.nn.functional as F
from torch import Tensor

from dgc_pose.training.synthesis.draw import Draw
from dgc_pose.training.synthesis.options import PhotometricOptions

_STEP = np.arange(8)
# The orthonormal cosine transform of 8 values (DCT-II).
_COSINES = np.cos(np.pi * (2 * _STEP + 1) * _STEP[:, None] / 16) / 2
_COSINES[0] /= math.sqrt(2)
_FOCUS_RADIUS = 3  # pixels, of the focus blur's kernel
# T.81, annex K.1: quantisation of luminance and chrominance at quality 50.
_LUMINANCE = (
    (16, 11, 10, 16, 24, 40, 51, 61),
    (12, 12, 14, 19, 26, 58, 60, 55),
    (14, 13, 16, 24, 40, 57, 69, 56),
    (14, 17, 22, 29, 51, 87, 80, 62),
    (18, 22, 37, 56, 68, 109, 103, 77),
    (24, 35, 55, 64, 81, 104, 113, 92),
    (49, 64, 78, 87, 103, 121, 120, 101),
    (72, 92, 95, 98, 112, 100, 103, 99),
)
_CHROMINANCE = (
    (17, 18, 24, 47, 99, 99, 99, 99),
    (18, 21, 26, 66, 99, 99, 99, 99),
    (24, 26, 56, 99, 99, 99, 99, 99),
    (47, 66, 99, 99, 99, 99, 99, 99),
    *((99,) * 8,) * 4,
)
# JFIF: Y, Cb and Cr from R, G and B.
_YCC = (
    (0.299, 0.587, 0.114),
    (-0.168735892, -0.331264108, 0.5),
    (0.5, -0.418687589, -0.081312411),
)
_MCU = 16  # pixels that luminance and halved chrominance share blocks in


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
    """Images (B, 3, H, W) in [0, 1], RGB, written as JPEG of `quality` (B,), 1 to 100, and read:
    whole 255ths.

    Follows ITU-T T.81, JFIF and libjpeg's defaults: full-range YCbCr, chroma at half the width and
    height, 8x8 DCT, the standard's example tables scaled by libjpeg's quality, chroma upsampled by
    its triangle filter. Entropy coding is lossless and left out.
    """
    height, width = images.shape[2:]
    padding = (0, -width % _MCU, 0, -height % _MCU)
    pixels = F.pad((255 * images).round().clamp(0, 255), padding, mode="replicate")
    forward = torch.tensor(_YCC, dtype=torch.float64)
    ycc = torch.einsum("ij,bjhw->bihw", _as(pixels, forward), pixels)
    # Level-shifted: chroma is about 0 already.
    luma = _quantised((ycc[:, :1] - 128).round(), _table(_LUMINANCE, quality)) + 128
    chroma = F.avg_pool2d(ycc[:, 1:], 2).round()
    chroma = _quantised(chroma, _table(_CHROMINANCE, quality)).round().clamp(-128, 127)
    chroma = F.interpolate(chroma, scale_factor=2, mode="bilinear", align_corners=False)
    decoded = torch.cat([luma.round().clamp(0, 255), chroma], 1)
    back = _as(pixels, torch.linalg.inv(forward))
    rgb = torch.einsum("ij,bjhw->bihw", back, decoded)[:, :, :height, :width]
    return rgb.round().clamp(0, 255) / 255


def _table(base: tuple[tuple[int, ...], ...], quality: Tensor) -> Tensor:
    """libjpeg's quantisation tables (B, 1, 1, 1, 8, 8) of qualities (B,)."""
    quality = quality.round().clamp(1, 100)[:, None, None]
    percent = torch.where(quality < 50, (5000 / quality).floor(), 200 - 2 * quality)
    steps = ((_as(percent, torch.tensor(base)) * percent + 50) / 100).floor().clamp(1, 255)
    return steps[:, None, None, None]


def _quantised(planes: Tensor, steps: Tensor) -> Tensor:
    """Planes (B, C, H, W) with each 8x8 block's cosine coefficients rounded to whole steps."""
    basis = _as(planes, torch.from_numpy(_COSINES))
    blocks = planes.unfold(2, 8, 8).unfold(3, 8, 8)  # (B, C, H / 8, W / 8, 8, 8)
    coefficients = basis @ blocks @ basis.T
    coefficients = (coefficients / steps).round() * steps
    blocks = basis.T @ coefficients @ basis
    return blocks.transpose(3, 4).reshape(planes.shape)


def _as(like: Tensor, constant: Tensor) -> Tensor:
    """A CPU constant of the type and on the device of another tensor, without waiting for it."""
    return constant.to(like, non_blocking=True)
