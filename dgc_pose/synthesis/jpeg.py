"""The losses of JPEG compression on batches of views, without a file.

Follows ITU-T T.81, JFIF and libjpeg's defaults: full-range YCbCr, chroma at half the width and
height, 8x8 DCT, the standard's example tables scaled by libjpeg's quality, chroma upsampled by its
triangle filter. Entropy coding is lossless and left out.
"""

from __future__ import annotations

import numpy as np
import torch
import torch.nn.functional as F
from scipy.fft import dct
from torch import Tensor

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


def jpeg_round_trip(images: Tensor, quality: Tensor) -> Tensor:
    """Images (B, 3, H, W) in [0, 1], RGB, written as JPEG of `quality` (B,), 1 to 100, and read.

    Returns values in [0, 1] that are whole 255ths.
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
    basis = _as(planes, torch.from_numpy(dct(np.eye(8), axis=0, norm="ortho")))
    blocks = planes.unfold(2, 8, 8).unfold(3, 8, 8)  # (B, C, H / 8, W / 8, 8, 8)
    coefficients = basis @ blocks @ basis.T
    coefficients = (coefficients / steps).round() * steps
    blocks = basis.T @ coefficients @ basis
    return blocks.transpose(3, 4).reshape(planes.shape)


def _as(like: Tensor, constant: Tensor) -> Tensor:
    """A CPU constant of the type and on the device of another tensor, without waiting for it."""
    return constant.to(like, non_blocking=True)
