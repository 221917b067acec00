"""Tensors of other tools as images."""

from __future__ import annotations

from typing import Any

import numpy as np

from dgc_pose.errors import InputError
from dgc_pose.images.image import Image


def image_of_tensor(tensor: Any, name: str) -> Image:
    """An image from a tensor (C, H, W) of one or three channels, values in [0, 1].

    Values outside of [0, 1], which resampling may leave, are clipped. Raises InputError, naming the
    argument, for another shape and for values that are not finite.
    """
    array = np.asarray(tensor.detach().float().cpu().numpy())
    if array.ndim != 3 or array.shape[0] not in (1, 3) or array.size == 0:
        raise InputError(f"{name} must have shape (1, H, W) or (3, H, W), not {array.shape}")
    if not np.isfinite(array).all():
        raise InputError(f"{name} has values that are not finite")
    pixels = np.rint(array.clip(0, 1) * 255).astype(np.uint8).transpose(1, 2, 0)
    return Image(np.ascontiguousarray(np.broadcast_to(pixels, (*pixels.shape[:2], 3))), name)
