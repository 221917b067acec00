"""Normalisation of the network's input by ImageNet's channel statistics."""

from __future__ import annotations

from torch import Tensor

from dgc_pose.network.constants import DEVIATION, MEAN


def normalise(images: Tensor) -> Tensor:
    """RGB images (B, 3, H, W) in [0, 1] to the network's input."""
    mean = images.new_tensor(MEAN)[:, None, None]
    deviation = images.new_tensor(DEVIATION)[:, None, None]
    return (images - mean) / deviation
