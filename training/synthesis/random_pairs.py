"""Random pairs with a known map, from photographs, ray-cast scenes and real scenes."""

import math
from dataclasses import replace

import torch
import torch.nn.functional as F
from torch import Tensor

from dgc_pose.errors import InputError
from dgc_pose.training.synthesis.depth_pairs import depth_pairs
from dgc_pose.training.synthesis.depth_scenes import DepthScenes
from dgc_pose.training.synthesis.draw import Draw
from dgc_pose.training.synthesis.map_pairs import MapPairs, joined, point_grid
from dgc_pose.training.synthesis.options import PairOptions
from dgc_pose.training.synthesis.photometric import random_photometric
from dgc_pose.training.synthesis.photos import Photos
from dgc_pose.training.synthesis.render.rendered_pairs import render_pairs
from dgc_pose.training.synthesis.warps import random_warp, rotation_2d


def make_pairs(
    photos: Photos,
    batch: int,
    size: int,
    generator: torch.Generator,
    options: PairOptions,
    real: DepthScenes | None = None,
) -> MapPairs:
    """A batch of random pairs of views of `size` pixels a side, on the device of `photos`.

    All draws come from `generator`, which is on the CPU. `real` is on the device of `photos`.
    Raises InputError if `real_share` is not zero and there is no `real`.
    """
    if options.real_share > 0 and real is None:
        raise InputError("real_share is not zero, and there are no real scenes")
    kind = torch.rand(batch, generator=generator)
    is_scene = kind < options.scene_share
    scenes = int(is_scene.sum())
    reals = int((~is_scene & (kind >= 1 - options.real_share)).sum())
    warped = batch - scenes - reals
    parts = []
    if warped:
        parts.append(_warped_pairs(photos, warped, size, generator, options))
    if scenes:
        views = render_pairs(photos.textures, scenes, size, generator, options.scenes)
        parts.append(MapPairs(views.image1, views.image2, views.map, views.visible))
    if reals and real is not None:
        parts.append(depth_pairs(real, reals, size, generator, options.real))
    pairs = parts[0] if len(parts) == 1 else joined(parts)
    if options.photometric is None:
        return pairs
    return replace(
        pairs,
        image1=random_photometric(pairs.image1, options.photometric, generator),
        image2=random_photometric(pairs.image2, options.photometric, generator),
    )


def _warped_pairs(
    photos: Photos, batch: int, size: int, generator: torch.Generator, options: PairOptions
) -> MapPairs:
    pixels = photos.pixels
    chosen = Draw(generator, pixels.device).integers(batch, count=len(pixels))
    textures = pixels[chosen].float() / 255
    axis = (2 * torch.arange(size, device=pixels.device) + 1) / size - 1
    grid = point_grid(axis).expand(batch, -1, -1)
    source = random_warp(batch, options.warps, generator)(grid)
    linear, shift = _random_views(batch, generator, options)
    linear, shift = linear.to(grid, non_blocking=True), shift.to(grid, non_blocking=True)

    def view(points: Tensor) -> Tensor:
        in_photo = (points @ linear.transpose(1, 2) + shift[:, None]).view(batch, size, size, 2)
        return F.grid_sample(textures, in_photo, padding_mode="reflection", align_corners=False)

    image1, image2 = view(grid), view(source)
    valid = (source.abs() <= 1).all(-1).view(batch, size, size)
    others = textures.roll(1, 0)
    image1, hidden1 = _occlude(image1, others, generator, options.occluder_share)
    image2, hidden2 = _occlude(image2, others, generator, options.occluder_share)
    source = source.view(batch, size, size, 2)
    behind = F.grid_sample(hidden1.float(), source, mode="nearest", align_corners=False) > 0.5
    valid &= ~behind[:, 0] & ~hidden2[:, 0]
    return MapPairs(image1, image2, ((source + 1) * size - 1) / 2, valid)


def _random_views(
    batch: int, generator: torch.Generator, options: PairOptions
) -> tuple[Tensor, Tensor]:
    """Source views as maps to their photographs: (B, 2, 2) and (B, 2), normalised."""
    draw = Draw(generator)
    scale = draw.uniform(batch, low=options.view_scale[0], high=options.view_scale[1])
    roll = math.radians(options.view_roll_deg) * draw.normal(batch)
    mirrored = 1 - 2 * draw.chance(batch, share=0.5).float()
    linear = scale[:, None, None] * rotation_2d(roll)
    linear[:, :, 0] *= mirrored[:, None]
    return linear, (1 - scale)[:, None] * (2 * draw.uniform(batch, 2) - 1)


def _occlude(
    images: Tensor, others: Tensor, generator: torch.Generator, share: float
) -> tuple[Tensor, Tensor]:
    """A `share` of the views behind an ellipse cut from another photograph, and the ellipses'
    masks (B, 1, S, S)."""
    batch, _, size, _ = images.shape
    random = Draw(generator, images.device, images.dtype).uniform(batch, 7)
    axis = torch.linspace(-1, 1, size, device=images.device)
    y, x = torch.meshgrid(axis, axis, indexing="ij")
    x0, y0, radius1, radius2, angle, chance, zoom = random[..., None, None].unbind(1)
    dx, dy = x - (2 * x0 - 1), y - (2 * y0 - 1)
    cos, sin = (math.pi * angle).cos(), (math.pi * angle).sin()
    along = (cos * dx + sin * dy) / (0.1 + 0.4 * radius1)
    across = (-sin * dx + cos * dy) / (0.1 + 0.4 * radius2)
    hidden = ((along.square() + across.square() < 1) & (chance < share))[:, None]
    grid = torch.stack([x, y], -1)[None] * (0.5 + 0.5 * zoom)[..., None]
    patch = F.grid_sample(others, grid.expand(batch, -1, -1, -1), align_corners=False)
    return torch.where(hidden, patch, images), hidden
