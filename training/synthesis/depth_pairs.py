"""Pairs from real scenes of known depth: the map follows from the target's depth and the poses.

The counterpart of the paper's training on real 3D scenes. Pixels that the depth decides nothing
about are not `MapPairs.known`.
"""

import math

import torch
import torch.nn.functional as F
from torch import Tensor

from dgc_pose.training.synthesis.depth_scenes import DepthScenes, depth_at
from dgc_pose.training.synthesis.draw import Draw
from dgc_pose.training.synthesis.map_pairs import MapPairs, point_grid
from dgc_pose.training.synthesis.options import DepthOptions
from dgc_pose.training.synthesis.warps import rotation_2d

_IN_FRONT = 1e-3  # median depths before a camera; nearer points are not projected


def depth_pairs(
    scenes: DepthScenes,
    batch: int,
    size: int,
    generator: torch.Generator,
    options: DepthOptions,
) -> MapPairs:
    """Random pairs of views of `size` pixels a side, on the device of `scenes`.

    A pixel of the target is visible if it projects into the source view and the source's depth
    agrees there. It is not visible if it projects outside, or well behind the source's depth.
    It is not known if the depth of either is missing, or the two contradict each other.
    """
    device = scenes.images.device
    chosen = torch.randint(len(scenes.pairs), (batch,), generator=generator)
    source, target = scenes.pairs[chosen].to(device, non_blocking=True).unbind(1)
    pose = scenes.source_from_target[chosen.to(device, non_blocking=True)]
    views = random_views(2 * batch, scenes.images.shape[-1], size, generator, options)
    (linear1, linear2), (shift1, shift2) = (
        part.to(device, non_blocking=True).chunk(2) for part in views
    )
    pixels = point_grid(torch.arange(size, dtype=torch.float32, device=device))
    in_frame1 = pixels @ linear1.mT + shift1[:, None]
    in_frame2 = pixels @ linear2.mT + shift2[:, None]
    image1 = _cut(scenes.images[source], in_frame1, size)
    image2 = _cut(scenes.images[target], in_frame2, size)

    z, measured = depth_at(scenes.depth, target, in_frame2)
    K = scenes.K[target]
    rays = (in_frame2 - K[:, None, :2, 2]) / K.diagonal(dim1=1, dim2=2)[:, None, :2]
    point = torch.cat([rays * z[..., None], z[..., None]], -1)
    point = point @ pose[:, :, :3].mT + pose[:, None, :, 3]
    in_front = point[..., 2] > _IN_FRONT
    expected = point[..., 2].clamp(min=_IN_FRONT)
    flat = point @ scenes.K[source].mT
    projected = (flat[..., :2] / expected[..., None]).clamp(-1e6, 1e6)
    in_view = (projected - shift1[:, None]) @ torch.linalg.inv_ex(linear1).inverse.mT
    inside = in_front & (in_view >= 0).all(-1) & (in_view <= size - 1).all(-1)

    measured1, seen = depth_at(scenes.depth, source, projected)
    ratio = measured1 / expected
    visible = inside & seen & ((ratio - 1).abs() < options.agree)
    hidden = inside & seen & (ratio < 1 - options.hidden)
    known = measured & (visible | hidden | ~inside)
    in_view = in_view.masked_fill(~(measured & in_front)[..., None], -1.0)
    truth = (in_view, visible & measured, known)
    return MapPairs(image1, image2, *(values.unflatten(1, (size, size)) for values in truth))


def random_views(
    count: int, side: int, size: int, generator: torch.Generator, options: DepthOptions
) -> tuple[Tensor, Tensor]:
    """Views of frames as maps x' = A x + b to the frame's pixels: A (B, 2, 2), b (B, 2), on the
    CPU."""
    draw = Draw(generator)
    scale = draw.uniform(count, low=options.view_scale[0], high=options.view_scale[1])
    roll = math.radians(options.view_roll_deg) * draw.normal(count)
    linear = (scale * side / size)[:, None, None] * rotation_2d(roll)
    margin = (1 - scale)[:, None] * side / 2
    middle = (side - 1) / 2 + margin * (2 * draw.uniform(count, 2) - 1)
    return linear, middle - linear.sum(2) * (size - 1) / 2


def _cut(frames: Tensor, points: Tensor, size: int) -> Tensor:
    """Views (B, 3, size, size) in [0, 1] of frames (B, 3, h, h) uint8 at points in pixels."""
    grid = ((2 * points + 1) / frames.shape[-1] - 1).view(-1, size, size, 2)
    return F.grid_sample(
        frames.float() / 255, grid, padding_mode="reflection", align_corners=False
    ).clamp(0, 1)
