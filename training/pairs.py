"""Batches of random pairs of all kinds, made on the network's device, and warped photographs."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path

import numpy as np
import torch
import torch.nn.functional as F
from torch import Tensor

from dgc_pose.errors import InputError
from dgc_pose.training.draw import Draw, other_light
from dgc_pose.training.options import Shares
from dgc_pose.training.photos import Photos, load_photos, spacing
from dgc_pose.training.posed_frames import PosedFrame, read_scenes
from dgc_pose.training.posed_pairs import FramePairs, frame_pairs, load_posed, posed_pairs
from dgc_pose.training.room_pairs import room_pairs
from dgc_pose.training.views import (
    MapPairs,
    Shape,
    inside,
    middle_of,
    pixel_grid,
    root_area,
    rotation_2d,
)

TRAINING = "training"  # name of the source for training; all others validate
_STARTS = range(1000)
_FARTHEST = 20.0  # a view's plane ends at this depth, in units of the depth of its middle
_OCCLUDED = 0.3  # share of the views with an occluder
_BENT = 0.4  # share of the pairs with a smooth bend besides the projective maps
_AWAY = 1e4  # pixels; coordinate of points beyond a view's horizon, and bound of all others


@dataclass(frozen=True)
class PairSource:
    """The data that pairs are made of, on the network's device."""

    photos: Photos
    posed: FramePairs | None = None
    shares: Shares = Shares()

    def make(self, count: int, shape: Shape, draw: Draw) -> MapPairs:
        """Make `count` pairs of views of `shape`, each view in random light, ordered by kind.

        Raises InputError if no kind with a share has data.
        """
        photos = self.photos
        posed = self.posed
        there = True, len(photos.places) > 0, True, posed is not None
        ends = np.cumsum(np.multiply(self.shares, there))
        if not ends[-1]:
            raise InputError("shares: no kind of pairs with a share has data")
        # Evenly spaced from a random start, so that small batches have all kinds, too.
        places = (np.arange(count) + draw.choice(_STARTS) / len(_STARTS)) * ends[-1] / count
        kinds = ends.searchsorted(places, "right")
        warped, relit, rooms, cut = np.bincount(kinds, minlength=4).tolist()
        parts = []
        if warped:
            parts.append(warped_pairs(photos, warped, shape, draw, light=False))
        if relit:
            parts.append(warped_pairs(photos, relit, shape, draw, light=True))
        if rooms:
            parts.append(room_pairs(photos, rooms, shape, draw).maps)
        if cut and posed is not None:
            parts.append(posed_pairs(posed, cut, shape, draw))
        image1, image2, truth, valid, known = map(torch.cat, zip(*parts, strict=True))
        image1, image2 = other_light(torch.cat([image1, image2]), draw).chunk(2)
        return MapPairs(image1, image2, truth, valid & known, known)


def load_data(
    photos: Path,
    light: Path | None = None,
    posed: Sequence[Path] = (),
    *,
    depths: Path,
    held: Sequence[str] = (),
    shares: Shares,
    device: torch.device | str = "cpu",
) -> dict[str, PairSource]:
    """Load the source for training, with the name TRAINING, and the sources for validation: photos,
    rooms and, if `held` names scenes, posed photographs.

    photos, light: see `load_photos`; posed: folders for `read_scenes`; depths: `kept` of
    `load_posed`; held: names of the scenes for validation. Raises the errors of these functions and
    of `frame_pairs`; InputError for a scene that is missing or found twice.
    """
    frames: dict[str, list[PosedFrame]] = {}
    for root in posed:
        found = read_scenes(root)
        if twice := sorted(frames.keys() & found):
            raise InputError(f"posed: two folders have a scene {twice[0]}, the second is {root}")
        frames |= found
    if missing := sorted(set(held) - set(frames)):
        raise InputError(f"held: there is no scene {missing[0]}")
    trains = [name for name in frames if name not in held] if shares.posed else []
    if frames and shares.posed and not trains:
        raise InputError("held: all scenes of posed are held back")
    needed = {name: scene for name, scene in frames.items() if name in held or name in trains}
    training, held_back = load_photos(photos, light, device)
    scenes = load_posed(needed, device, depths) if needed else None
    pairs = frame_pairs(scenes, trains) if scenes is not None and trains else None
    sources = {
        TRAINING: PairSource(training, pairs, shares),
        "photos": PairSource(held_back, shares=Shares(1, 0, 0, 0)),
        "rooms": PairSource(held_back, shares=Shares(0, 0, 1, 0)),
    }
    if scenes is not None and held:
        sources["posed"] = PairSource(held_back, frame_pairs(scenes, held), Shares(0, 0, 0, 1))
    return sources


def warped_pairs(photos: Photos, count: int, shape: Shape, draw: Draw, light: bool) -> MapPairs:
    """Random pairs of views of `shape`.

    light: whether the views show two aligned photographs of one place, in different light or
    exposure; else both show one photograph. A view is projective: foreshortened down to 0.35,
    rolled, enlarged up to twice. The truth is unknown where the target reaches beyond its
    photograph.
    """
    bank = photos.bank
    if light:
        source, target = photos.places_drawn(count, draw)
    else:
        source = target = draw.integers(count, count=photos.single)
    to_source, to_target = _random_views(bank.size(target), shape, draw)
    pixels = pixel_grid(shape, draw.device).expand(count, -1, -1, -1)
    in_target = _apply(to_target, pixels)[0]
    bend = 0.07 * draw.uniform(count, 1, 1, 1) * draw.chance(count, 1, 1, 1, share=_BENT)
    knots = F.interpolate(draw.normal(count, 2, 5, 5), shape, mode="bicubic", align_corners=False)
    reach = bend * root_area(shape) * spacing(in_target)[..., None]
    in_target = in_target + reach * knots.movedim(1, -1) / 2
    found, depth = _apply(torch.linalg.inv_ex(to_source).inverse, in_target)
    truth = torch.where(depth[..., None] > 1 / _FARTHEST, found, _AWAY).clamp(-_AWAY, _AWAY)
    in_source = _apply(to_source, pixels)[0]
    image1, hidden1 = occluded(photos, bank.view(source, in_source), draw)
    image2, hidden2 = occluded(photos, bank.view(target, in_target), draw)
    place = (2 * truth + 1) / truth.new_tensor(shape[::-1]) - 1
    behind = F.grid_sample(hidden1.float()[:, None], place, align_corners=False)[:, 0] > 0.3
    on_view = inside(truth, shape)
    on_photo = inside(in_target, bank.size(target)[:, None, None])
    known = on_photo | ~on_view | hidden2
    valid = on_view & on_photo & ~hidden2 & ~behind
    return MapPairs(image1.movedim(-1, 1), image2.movedim(-1, 1), truth, valid, known)


def _random_views(size: Tensor, shape: Shape, draw: Draw) -> list[Tensor]:
    """Homographies (B, 3, 3) from pixels of the source view and of the target view to pixels of the
    photographs. size: (B, 2), width and height of the photographs."""
    count = len(size)
    extent = size.new_tensor(shape[::-1]) / root_area(shape)
    most = (size / extent).amin(1) / 2
    side2 = most * draw.log_uniform(count, low=0.5, high=1.0)
    side1 = (side2 * draw.log_uniform(count, low=0.6, high=1.65)).minimum(1.05 * most)
    free = (size / 2 - side2[:, None] * extent).clamp(min=0)
    centre2 = (size - 1) / 2 + free * draw.uniform(count, 2, low=-1)
    apart = 0.28 * side1.maximum(side2)[:, None] * draw.normal(count, 2).clamp(-2, 2)
    roll = math.radians(6) * draw.normal(count)
    slanted = draw.chance(count, share=0.75)
    views = []
    for side, centre in ((side1, centre2 + apart), (side2, centre2)):
        # In half of the slanted pairs, this view is strongly foreshortened.
        strong = slanted & draw.chance(count, share=0.5)
        squeeze = draw.uniform(count, low=0.35, high=0.95)
        squeeze = torch.where(strong, squeeze, draw.uniform(count, low=0.8))
        axis = draw.uniform(count, high=math.pi)
        stretch = torch.diag_embed(torch.stack([squeeze**-0.5, squeeze**0.5], -1))  # area kept
        linear = rotation_2d(roll + math.radians(13) * draw.normal(count)) @ rotation_2d(axis)
        linear = linear @ stretch @ rotation_2d(-axis) * side[:, None, None]
        slope = 0.45 * draw.uniform(count, low=-1) * (1 - squeeze**2).clamp(min=0.02).sqrt()
        tilt = slope[:, None] * torch.stack([axis.cos(), axis.sin()], -1)
        tilt = tilt + 0.04 * draw.normal(count, 2)
        # The view's corners stay on this side of the horizon.
        tilt = tilt * (0.62 / (tilt.abs() * extent).sum(1).clamp(min=0.62))[:, None]
        # centre + linear u / (1 + tilt u); u is 0 in the middle of the view, whose area is 4
        upper = torch.cat([linear + centre[..., None] * tilt[:, None], centre[..., None]], -1)
        views.append(torch.cat([upper, F.pad(tilt, (0, 1), value=1.0)[:, None]], 1))
    scale = 2 / root_area(shape)
    units = torch.diag(size.new_tensor([scale, scale, 1.0]))
    units[:2, 2] = -scale * middle_of(shape, draw.device)
    return [view @ units for view in views]


def _apply(matrix: Tensor, points: Tensor) -> tuple[Tensor, Tensor]:
    """Map points (B, H, W, 2) by homographies (B, 3, 3); also return the third coordinates
    (B, H, W), which are positive on the view's side of the horizon."""
    moved = torch.einsum("bij,bhwj->bhwi", matrix, F.pad(points, (0, 1), value=1.0))
    depth = moved[..., 2]
    return moved[..., :2] / depth.clamp(min=1e-3)[..., None], depth


def occluded(
    photos: Photos, images: Tensor, draw: Draw, share: float = _OCCLUDED
) -> tuple[Tensor, Tensor]:
    """Cover part of a `share` of the views (B, H, W, 3) with a blot cut from another photograph;
    also return the blots' masks (B, H, W)."""
    count = len(images)
    shape = (images.shape[1], images.shape[2])
    place = (pixel_grid(shape, draw.device) - middle_of(shape, draw.device)) * 2 / root_area(shape)
    offset = place - draw.uniform(count, 1, 1, 2, low=-0.9, high=0.9)
    turn = rotation_2d(draw.uniform(count, high=math.pi))
    radii = draw.uniform(count, 1, 1, 2, low=0.1, high=0.45)
    offset = torch.einsum("bij,bhwj->bhwi", turn, offset) / radii
    angle = torch.atan2(offset[..., 1], offset[..., 0])
    edge = 1 - 0.25 * torch.sin(3 * angle + draw.uniform(count, 1, 1, high=2 * math.pi))
    hidden = (offset.norm(dim=-1) < edge) & draw.chance(count, 1, 1, share=share)
    other = draw.integers(count, count=photos.single)
    size = photos.bank.size(other)[:, None, None]
    shift = draw.uniform(count, 1, 1, 2, low=-0.2, high=0.2)
    points = size / 2 + 0.4 * size.amin(-1, keepdim=True) * (place + shift)
    return torch.where(hidden[..., None], photos.bank.view(other, points), images), hidden
