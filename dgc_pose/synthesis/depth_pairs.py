"""Training pairs from real scenes of known depth: the map by the target's depth and the poses.

The counterpart of the paper's training on real 3D scenes. What the depth cannot tell, neither the
map nor the mask learns from: see `MapPairs.known`.
"""

from __future__ import annotations

import math
from dataclasses import dataclass

import torch
import torch.nn.functional as F
from torch import Tensor

from dgc_pose.errors import InputError
from dgc_pose.synthesis.depth_scenes import DepthScenes, depth_at
from dgc_pose.synthesis.map_pairs import MapPairs

_IN_FRONT = 1e-3  # median depths before a camera; nearer points have no place in its view


@dataclass(frozen=True)
class DepthOptions:
    """How views are cut from frames, and what the depth of the two tells."""

    view_scale: tuple[float, float] = (0.6, 1.0)  # of the frame's side
    view_roll_deg: float = 8.0  # standard deviation of the view's rotation in the frame
    # The source's own depth where a target's pixel lies in it, over the depth expected there:
    agree: float = 0.02  # within this of 1, the pixel is visible
    hidden: float = 0.05  # less than 1 by more, something stands before it; else it is not known

    def __post_init__(self) -> None:
        if not 0 < self.view_scale[0] <= self.view_scale[1] <= 1:
            raise InputError(f"view_scale must be two shares, low first, not {self.view_scale}")
        if not 0 < self.agree <= self.hidden < 1:
            raise InputError("agree and hidden must be shares, agree the smaller one")


def depth_pairs(
    scenes: DepthScenes,
    batch: int,
    size: int,
    generator: torch.Generator,
    options: DepthOptions,
) -> MapPairs:
    """Random pairs of views of `size` pixels a side, on the device of `scenes`.

    A pixel of the target is visible where it projects into the source view and the source's depth
    agrees there. It is not visible where it projects outside, or well behind the source's depth.
    Where its own depth is missing, or the source's, or the two contradict each other, nothing is
    known of it.
    """
    device = scenes.images.device
    chosen = torch.randint(len(scenes.pairs), (batch,), generator=generator)
    # Draws are made on the CPU; from pageable memory the copy is taken before a call returns.
    source, target = scenes.pairs[chosen].to(device, non_blocking=True).unbind(1)
    pose = scenes.source_from_target[chosen.to(device, non_blocking=True)]
    views = random_views(2 * batch, scenes.images.shape[-1], size, generator, options)
    (linear1, shift1), (linear2, shift2) = (
        tuple(part.to(device, non_blocking=True) for part in view) for view in views
    )

    axis = torch.arange(size, dtype=torch.float32, device=device)
    pixels = torch.stack(torch.meshgrid(axis, axis, indexing="xy"), -1).view(1, -1, 2)
    in_frame1 = pixels @ linear1.mT + shift1[:, None]
    in_frame2 = pixels @ linear2.mT + shift2[:, None]
    image1 = _look(scenes.images[source], in_frame1, size)
    image2 = _look(scenes.images[target], in_frame2, size)

    z, measured = depth_at(scenes.depth, target, in_frame2)
    point = _back_project(scenes.K[target], in_frame2, z) @ pose[:, :, :3].mT + pose[:, None, :, 3]
    in_front = point[..., 2] > _IN_FRONT
    expected = point[..., 2].clamp(min=_IN_FRONT)
    flat = point @ scenes.K[source].mT
    place1 = (flat[..., :2] / expected[..., None]).clamp(-1e6, 1e6)
    place = (place1 - shift1[:, None]) @ torch.linalg.inv_ex(linear1).inverse.mT
    inside = in_front & (place >= 0).all(-1) & (place <= size - 1).all(-1)

    found, seen = depth_at(scenes.depth, source, place1)
    ratio = found / expected
    visible = inside & seen & ((ratio - 1).abs() < options.agree)
    hidden = inside & seen & (ratio < 1 - options.hidden)
    known = measured & (visible | hidden | ~inside)
    place = place.masked_fill(~(measured & in_front)[..., None], -1.0)
    grid = (batch, size, size)
    return MapPairs(
        image1,
        image2,
        place.view(*grid, 2),
        (visible & measured).view(grid),
        known.view(grid),
    )


def random_views(
    count: int, side: int, size: int, generator: torch.Generator, options: DepthOptions
) -> tuple[tuple[Tensor, Tensor], tuple[Tensor, Tensor]]:
    """For the sources and the targets: where a view's pixel lies in the frame, x' = A x + b.

    A (B, 2, 2), b (B, 2), pixels.
    """
    low, high = options.view_scale
    scale = low + (high - low) * torch.rand(count, generator=generator)
    roll = math.radians(options.view_roll_deg) * torch.randn(count, generator=generator)
    cos, sin = roll.cos(), roll.sin()
    turn = torch.stack([cos, -sin, sin, cos], -1).view(-1, 2, 2)
    linear = (scale * side / size)[:, None, None] * turn
    room = (1 - scale)[:, None] * side / 2
    middle = (side - 1) / 2 + room * (2 * torch.rand(count, 2, generator=generator) - 1)
    shift = middle - linear.sum(2) * (size - 1) / 2
    (linear1, linear2), (shift1, shift2) = linear.chunk(2), shift.chunk(2)
    return (linear1, shift1), (linear2, shift2)


def _look(frames: Tensor, places: Tensor, size: int) -> Tensor:
    """Views (B, 3, size, size) in [0, 1] of frames (B, 3, h, h) uint8 at places in pixels."""
    grid = ((2 * places + 1) / frames.shape[-1] - 1).view(-1, size, size, 2)
    return F.grid_sample(
        frames.float() / 255, grid, padding_mode="reflection", align_corners=False
    ).clamp(0, 1)


def _back_project(K: Tensor, pixels: Tensor, z: Tensor) -> Tensor:
    """Points (B, n, 3) in the camera of pixels (B, n, 2) at depths (B, n)."""
    focal = K.diagonal(dim1=1, dim2=2)[:, None, :2]
    rays = (pixels - K[:, None, :2, 2]) / focal
    return torch.cat([rays * z[..., None], z[..., None]], -1)
