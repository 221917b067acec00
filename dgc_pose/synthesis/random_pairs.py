"""Training pairs made on the fly: two views, the true map between them, and where it holds."""

from __future__ import annotations

import math
from dataclasses import dataclass, field, replace

import torch
import torch.nn.functional as F
from torch import Tensor

from dgc_pose.errors import InputError
from dgc_pose.synthesis.depth_pairs import DepthOptions, depth_pairs
from dgc_pose.synthesis.depth_scenes import DepthScenes
from dgc_pose.synthesis.map_pairs import MapPairs
from dgc_pose.synthesis.photometric import PhotometricOptions, random_photometric
from dgc_pose.synthesis.photos import Photos
from dgc_pose.synthesis.render import SceneOptions, render_pairs
from dgc_pose.synthesis.warps import WIDE, WarpOptions, random_warp


@dataclass(frozen=True)
class PairOptions:
    """What the training pairs are made of."""

    # Of the pairs: ray-cast 3D scenes, and real scenes of known depth; the rest are warped photos.
    scene_share: float = 0.5
    real_share: float = 0.0
    warps: WarpOptions = WIDE
    scenes: SceneOptions = field(default_factory=SceneOptions)
    real: DepthOptions = field(default_factory=DepthOptions)
    # None: both views in the photograph's own light.
    photometric: PhotometricOptions | None = field(default_factory=PhotometricOptions)
    view_scale: tuple[float, float] = (0.5, 1.0)  # a warped pair's view, of the photograph's side
    view_roll_deg: float = 20.0  # standard deviation of the view's rotation in the photograph
    occluder_share: float = 0.3  # of the views of warped pairs that something stands before

    def __post_init__(self) -> None:
        for name in ("scene_share", "real_share", "occluder_share"):
            if not 0 <= getattr(self, name) <= 1:
                raise InputError(f"{name} must be a share of one, not {getattr(self, name)}")
        if self.scene_share + self.real_share > 1:
            raise InputError("scene_share and real_share must be shares of one")


def make_pairs(
    photos: Photos,
    batch: int,
    size: int,
    generator: torch.Generator,
    options: PairOptions,
    real: DepthScenes | None = None,
) -> MapPairs:
    """A batch of random pairs of views of `size` pixels a side, on the device of `photos`.

    generator: a CPU one; all draws come from it. real: on the device of `photos`; needed, else
    InputError is raised, where `real_share` is not zero.
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
        parts.append(_scene_pairs(photos, scenes, size, generator, options))
    if reals and real is not None:
        parts.append(depth_pairs(real, reals, size, generator, options.real))
    pairs = parts[0] if len(parts) == 1 else MapPairs.joined(parts)
    if options.photometric is None:
        return pairs
    return replace(
        pairs,
        image1=random_photometric(pairs.image1, options.photometric, generator),
        image2=random_photometric(pairs.image2, options.photometric, generator),
    )


def _scene_pairs(
    photos: Photos, batch: int, size: int, generator: torch.Generator, options: PairOptions
) -> MapPairs:
    pairs = render_pairs(photos.textures, batch, size, generator, options.scenes)
    return MapPairs(pairs.image1, pairs.image2, pairs.map, pairs.visible)


def _warped_pairs(
    photos: Photos, batch: int, size: int, generator: torch.Generator, options: PairOptions
) -> MapPairs:
    pixels = photos.pixels
    chosen = torch.randint(len(pixels), (batch,), generator=generator)
    # Draws are made on the CPU; from pageable memory the copy is taken before a call returns.
    textures = pixels[chosen.to(pixels.device, non_blocking=True)].float() / 255
    axis = (2 * torch.arange(size, device=pixels.device) + 1) / size - 1
    grid = torch.stack(torch.meshgrid(axis, axis, indexing="xy"), -1).view(1, -1, 2)
    grid = grid.expand(batch, -1, -1)
    place = random_warp(batch, options.warps, generator)(grid)
    linear, shift = _random_views(batch, generator, options)
    linear, shift = linear.to(grid, non_blocking=True), shift.to(grid, non_blocking=True)

    def look(points: Tensor) -> Tensor:
        in_photo = (points @ linear.transpose(1, 2) + shift[:, None]).view(batch, size, size, 2)
        return F.grid_sample(
            textures, in_photo, padding_mode="reflection", align_corners=False
        )

    image1, image2 = look(grid), look(place)
    valid = (place.abs() <= 1).all(-1).view(batch, size, size)
    others = textures.roll(1, 0)
    image1, hidden1 = _occlude(image1, others, generator, options.occluder_share)
    image2, hidden2 = _occlude(image2, others, generator, options.occluder_share)
    place = place.view(batch, size, size, 2)
    behind = F.grid_sample(hidden1.float(), place, mode="nearest", align_corners=False) > 0.5
    valid &= ~behind[:, 0] & ~hidden2[:, 0]
    return MapPairs(image1, image2, ((place + 1) * size - 1) / 2, valid)


def _random_views(
    batch: int, generator: torch.Generator, options: PairOptions
) -> tuple[Tensor, Tensor]:
    """Where the source view lies in its photograph: (B, 2, 2) and (B, 2), normalised."""
    low, high = options.view_scale
    scale = low + (high - low) * torch.rand(batch, generator=generator)
    roll = math.radians(options.view_roll_deg) * torch.randn(batch, generator=generator)
    mirrored = 1 - 2 * (torch.rand(batch, generator=generator) < 0.5).float()
    cos, sin = scale * roll.cos(), scale * roll.sin()
    linear = torch.stack([cos * mirrored, -sin, sin * mirrored, cos], -1).view(batch, 2, 2)
    room = (1 - scale)[:, None]
    return linear, room * (2 * torch.rand(batch, 2, generator=generator) - 1)


def _occlude(
    images: Tensor, others: Tensor, generator: torch.Generator, share: float
) -> tuple[Tensor, Tensor]:
    """Put an ellipse cut from another photograph before some views; also (B, 1, S, S) where."""
    batch, _, size, _ = images.shape
    random = torch.rand(batch, 7, generator=generator).to(images, non_blocking=True)
    axis = torch.linspace(-1, 1, size, device=images.device)
    y, x = torch.meshgrid(axis, axis, indexing="ij")
    centre = 2 * random[:, :2] - 1
    radii = 0.1 + 0.4 * random[:, 2:4]
    angle = math.pi * random[:, 4]
    dx = x - centre[:, 0, None, None]
    dy = y - centre[:, 1, None, None]
    cos, sin = angle.cos()[:, None, None], angle.sin()[:, None, None]
    along = (cos * dx + sin * dy) / radii[:, 0, None, None]
    across = (-sin * dx + cos * dy) / radii[:, 1, None, None]
    hidden = (along.square() + across.square() < 1) & (random[:, 5, None, None] < share)
    hidden = hidden[:, None]
    scale = 0.5 + 0.5 * random[:, 6, None, None]
    grid = torch.stack([x, y], -1)[None] * scale[..., None]
    patch = F.grid_sample(others, grid.expand(batch, -1, -1, -1), align_corners=False)
    return torch.where(hidden, patch, images), hidden
