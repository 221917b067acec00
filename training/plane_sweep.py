"""Depth maps of posed photographs, by a plane sweep with normalised correlation."""

from __future__ import annotations

import torch
import torch.nn.functional as F
from torch import Tensor

from dgc_pose.training.photos import ImageBank
from dgc_pose.training.views import Cameras, angle_deg, inside, pixel_grid

_SIDE = 256  # longest side, pixels
_PLANES = 72  # even in inverse depth
_MOST = 5  # neighbours to compare a frame with
_ANGLE_DEG = 10.0  # the best angle between rays of neighbours
_ANGLE_SPREAD = 8.0
_LEAST_ANGLE_DEG = 1.5
_LEAST_FIT = 0.05  # of a neighbour
_WINDOW = 7  # side of the correlated window, pixels
_VARIANCE = 6e-5  # least variance of a window
_NOISE = 2e-5  # variance added to it
_CORRELATION = 0.55  # least correlation
_MARGIN = 0.03  # least lead over planes elsewhere
_AGREES = 0.02  # largest relative difference of a neighbour's depth that agrees
_DENSITY = 0.3  # least share of kept pixels around a kept one: isolated pixels are chance


def swept_depths(bank: ImageBank, views: Cameras, reach: Tensor) -> list[Tensor]:
    """Sweep the bank's images, views of one scene: depths (h, w), smaller than the images, 0 where
    no plane stands out or the neighbours' depths disagree.

    reach: (n, 2), nearest and farthest depth of each image.
    """
    sizes = bank.sizes[:, 0].float()
    near = _neighbours(sizes, views, reach)
    greys = []
    K = []
    for frame, (own, size) in enumerate(zip(views.K, sizes, strict=True)):
        factor = min(1.0, _SIDE / float(size.max()))
        width, height = (round(factor * extent) for extent in size.cpu().tolist())
        scale = own.new_tensor([width, height]) / size
        points = (pixel_grid((height, width), own.device) + 0.5) / scale - 0.5
        colours = bank.sample(torch.tensor(frame, device=own.device), points, 1 / scale[:1])
        greys.append(colours @ own.new_tensor([0.299, 0.587, 0.114]))
        K.append(torch.cat([own[:2] * scale, (own[2:] + 0.5) * scale - 0.5]))
    small = Cameras(torch.stack(K), views.pose)
    depths = [_swept(greys, small, k, near[k], reach[k]) for k in range(len(greys))]
    return [_agreed(depths, small, k, near[k]) for k in range(len(greys))]


def _neighbours(size: Tensor, views: Cameras, reach: Tensor) -> list[list[int]]:
    """For each frame, neighbours of similar content and scale about 10 degrees away, best first."""
    step = torch.linspace(0.1, 0.9, 6, device=size.device)
    grid = torch.stack(torch.meshgrid(step, step, indexing="xy"), -1).view(1, -1, 2)
    middle = (2 / reach.reciprocal().sum(1))[:, None].expand(-1, grid.shape[1])
    points = views.unproject(grid * size[:, None], middle)
    result = []
    for k, own in enumerate(points):
        seen, depth = views.project(own.expand(len(size), -1, -1))
        shown = (inside(seen, size[:, None]) & (depth > 0)).float().mean(1)
        rays = own - views.centre[k]
        others = own - views.centre[:, None]
        angle = angle_deg(rays[None], others).median(1).values
        scale = (rays.norm(dim=-1) / others.norm(dim=-1).clamp(min=1e-9)).median(1).values
        off = ((angle - _ANGLE_DEG) / _ANGLE_SPREAD) ** 2 + (scale.log() / 0.5) ** 2
        fit = torch.exp(-off) * shown * (angle > _LEAST_ANGLE_DEG)
        best = fit.topk(min(_MOST, len(fit)))
        result.append(best.indices[best.values > _LEAST_FIT].cpu().tolist())
    return result


def _swept(greys: list[Tensor], views: Cameras, k: int, near: list[int], reach: Tensor) -> Tensor:
    """The depth (h, w) of the plane with the highest mean correlation of its best 3 neighbours."""
    grey = greys[k]
    if len(near) < 2:
        return torch.zeros_like(grey)
    pixels = pixel_grid(grey.shape, grey.device)
    share = torch.linspace(0, 1, _PLANES, device=grey.device)
    inverse = torch.lerp(1 / reach[1], 1 / reach[0], share)
    levels = (1 / inverse)[None, :, None, None].expand(1, -1, *grey.shape)
    place = views[[k]].unproject(pixels.expand(1, _PLANES, -1, -1, -1), levels)
    mean, variance = _moments(grey[None, None])
    scores = []
    for j in near:
        seen, depth = views[[j]].project(place)
        grid = (2 * seen[0] + 1) / seen.new_tensor(greys[j].shape[::-1]) - 1
        other = F.grid_sample(greys[j].expand(_PLANES, 1, -1, -1), grid, align_corners=False)
        other_mean, other_variance = _moments(other)
        product = _window_mean(other * grey) - other_mean * mean
        score = product / ((other_variance + _NOISE) * (variance + _NOISE)).sqrt()
        shown = inside(seen[0], greys[j].shape) & (depth[0] > 0)
        scores.append(torch.where(shown, score[:, 0], -1.0))
    scored = torch.stack(scores).topk(min(3, len(scores)), 0).values.clamp(min=-0.2).mean(0)
    best, index = scored.max(0)
    near_best = ((index + step).clamp(0, _PLANES - 1)[None] for step in (-1, 1))
    below, above = (scored.gather(0, plane)[0] for plane in near_best)
    # The peak of a parabola through three planes, evenly spaced in inverse depth.
    shift = 0.5 * (above - below) / (2 * best - below - above).clamp(min=1e-4)
    found = 1 / (inverse[index] + shift.clamp(-0.5, 0.5) * (inverse[1] - inverse[0]))
    elsewhere = (torch.arange(_PLANES, device=grey.device)[:, None, None] - index).abs() > 4
    second = torch.where(elsewhere, scored, -1.0).amax(0)
    good = (best > _CORRELATION) & (variance[0, 0] > _VARIANCE) & (best - second > _MARGIN)
    return torch.where(good & (index > 0) & (index < _PLANES - 1), found, 0.0)


def _agreed(depths: list[Tensor], views: Cameras, k: int, near: list[int]) -> Tensor:
    """A frame's depths (h, w) confirmed by 1 neighbour, or by 2 if it has more than 3; else 0."""
    depth = depths[k]
    pixels = pixel_grid(depth.shape, depth.device)[None]
    place = views[[k]].unproject(pixels, depth[None])
    confirming = torch.zeros_like(depth)  # number of neighbours for each pixel
    for j in near:
        seen, expected = (part[0] for part in views[[j]].project(place))
        x, y = (axis.round().long() for axis in seen.unbind(-1))
        height, width = depths[j].shape
        there = depths[j][y.clamp(0, height - 1), x.clamp(0, width - 1)]
        shown = inside(seen, (height, width)) & (expected > 0) & (there > 0)
        confirming += shown & ((there / expected - 1).abs() < _AGREES)
    kept = (depth > 0) & (confirming >= (2 if len(near) > 3 else 1))
    density = F.avg_pool2d(kept.float()[None, None], 5, 1, 2)[0, 0]
    return torch.where(kept & (density > _DENSITY), depth, 0.0)


def _moments(values: Tensor) -> tuple[Tensor, Tensor]:
    """Means and variances of the windows around each pixel of (B, 1, h, w)."""
    mean = _window_mean(values)
    return mean, (_window_mean(values**2) - mean**2).clamp(min=0)


def _window_mean(values: Tensor) -> Tensor:
    for size in ((1, _WINDOW), (_WINDOW, 1)):
        pad = (size[0] // 2, size[1] // 2)
        values = F.avg_pool2d(values, size, 1, pad, count_include_pad=False)
    return values
