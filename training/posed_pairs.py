"""Pairs of views of posed frames: the map follows from the target's depth and the poses.

The counterpart of the paper's training on real 3D scenes. Pixels that the depths decide nothing
about are not `MapPairs.known`.
"""

from __future__ import annotations

import math

import torch
from torch import Tensor

from dgc_pose.training.draw import Draw
from dgc_pose.training.map_pairs import MapPairs
from dgc_pose.training.posed_scenes import FramePairs
from dgc_pose.training.views import (
    Cameras,
    Shape,
    inside,
    middle_of,
    pixel_grid,
    root_area,
    rotation_2d,
)

_AGREES = 0.03  # of the depth expected in the source: within this of it, the pixel is visible
_HIDDEN = 0.07  # nearer by more, the pixel is occluded; else it is not known


def posed_pairs(pairs: FramePairs, count: int, shape: Shape, draw: Draw) -> MapPairs:
    """Random pairs of views of `shape`, cut from the frames: rolled, scaled down to 0.55 of the
    frame, about what both show.

    A pixel of the target is visible if it projects into the source view and the source's depth
    agrees there. It is not visible if it projects outside, or well behind the source's depth. It is
    not known if the depth of either is missing, or the two contradict each other.
    """
    scenes, place = pairs.scenes, draw.uniform(count).double() * pairs.chance[-1]
    chosen = torch.searchsorted(pairs.chance, place).clamp(max=len(pairs.frames) - 1)
    source, target = pairs.frames[chosen].unbind(1)
    middle1, middle2 = pairs.middles[chosen].unbind(1)
    linear1, shift1 = _random_cuts(scenes.bank.size(source), middle1, shape, draw)
    linear2, shift2 = _random_cuts(scenes.bank.size(target), middle2, shape, draw)
    pixels = pixel_grid(shape, draw.device).expand(count, -1, -1, -1)
    in_frame1, in_frame2 = _cut(linear1, shift1, pixels), _cut(linear2, shift2, pixels)
    image1 = scenes.bank.view(source, in_frame1)
    image2 = scenes.bank.view(target, in_frame2)
    depth = scenes.depth_at(target, in_frame2)
    camera1, camera2 = scenes.cameras[source], scenes.cameras[target]
    camera1 = camera1.seen_by(camera2)
    camera2 = Cameras(camera2.K, torch.eye(3, 4, device=draw.device).expand(count, 3, 4))
    projected, expected = camera1.project(camera2.unproject(in_frame2, depth))
    back = torch.linalg.inv_ex(linear1).inverse
    truth = torch.einsum("bij,bhwj->bhwi", back, projected - shift1[:, None, None])
    there, measured = scenes.depth_at(source, projected), depth > 0
    on_view = (expected > 1e-3 * depth) & inside(truth, shape)
    compared, ratio = on_view & (there > 0), there / expected
    visible = measured & compared & ((ratio - 1).abs() < _AGREES)
    known = measured & (visible | (compared & (ratio < 1 - _HIDDEN)) | ~on_view)
    return MapPairs(image1.movedim(-1, 1), image2.movedim(-1, 1), truth, visible, known)


def _random_cuts(size: Tensor, middle: Tensor, shape: Shape, draw: Draw) -> tuple[Tensor, Tensor]:
    """Views as maps A u + b from their pixels to the frames': A (B, 2, 2), b (B, 2).

    size: (B, 2), width and height of the frames; middle: (B, 2), pixels, about which a view lies.
    """
    count, extent = len(size), size.new_tensor(shape[::-1]) / root_area(shape)
    side = (size / extent).amin(1) * draw.log_uniform(count, low=0.55, high=1.0)
    aspect = draw.log_uniform(count, low=0.78, high=1.28)
    stretch = torch.stack([aspect.clamp(max=1), (1 / aspect).clamp(max=1)], -1)
    roll = rotation_2d(math.radians(7) * draw.normal(count))
    linear = roll @ torch.diag_embed(stretch * side[:, None] / root_area(shape))
    reach = (linear.abs() * size.new_tensor(shape[::-1])).sum(-1) / 2
    free = (size / 2 - reach).clamp(min=0)
    wanted = middle + 0.17 * side[:, None] * draw.normal(count, 2) - (size - 1) / 2
    centre = (size - 1) / 2 + wanted.minimum(free).maximum(-free)
    return linear, centre - linear @ middle_of(shape, draw.device)


def _cut(linear: Tensor, shift: Tensor, points: Tensor) -> Tensor:
    return torch.einsum("bij,bhwj->bhwi", linear, points) + shift[:, None, None]
