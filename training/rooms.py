"""Rooms of textured boxes and ellipsoids, by rays that meet them: images, depths and maps."""

from __future__ import annotations

from dataclasses import dataclass
from typing import NamedTuple

import torch
from torch import Tensor

from dgc_pose.training.bank import ImageBank
from dgc_pose.training.map_pairs import MapPairs
from dgc_pose.training.views import Cameras, Shape, inside, pixel_grid

FACES = 6  # -x +x -y +y -z +z; of an ellipsoid the sectors about these axes
LAYERS = 2  # of photographs on a face, of other spans: their repetitions do not coincide
_NEAR = 0.05  # units of length; nothing nearer to a camera is seen
_SAME = 1e-3  # of the depth: a surface this much nearer does not hide a point
_TINY = 1e-9  # in place of a direction's zero


class Rooms(NamedTuple):
    """B rooms of P primitives: a box seen from inside, boxes, then ellipsoids. World y points
    down."""

    axes: Tensor  # (B, P, 3, 3), world from primitive
    half: Tensor  # (B, P, 3), half sizes along these, units of length
    centre: Tensor  # (B, P, 3), world
    photo: Tensor  # (B, P, FACES, LAYERS) int64, of the bank
    span: Tensor  # (B, P, FACES, LAYERS), units of length that its shorter side covers
    origin: Tensor  # (B, P, FACES, LAYERS, 2), of the photograph's sides, in the face's middle
    weight: Tensor  # (B, P, FACES, LAYERS), of the colours; they sum to 1
    gain: Tensor  # (B, P, FACES, 3), of the colours
    ellipsoids: int  # the last ones of the primitives

    def chosen(self, which: Tensor) -> Rooms:
        """Some of the rooms, by their indices."""
        parts = self._asdict().items()
        return self._replace(**{k: part[which] for k, part in parts if k != "ellipsoids"})


@dataclass(frozen=True)
class RoomPairs:
    """Pairs of views of rooms, with their cameras."""

    maps: MapPairs
    source: Cameras
    target: Cameras
    depth1: Tensor  # (B, H, W), of the source along the optical axis, units of length
    depth2: Tensor  # (B, H, W), of the target


def first_hits(rooms: Rooms, origin: Tensor, rays: Tensor) -> tuple[Tensor, Tensor]:
    """Where rays first meet a surface: their parameters (B, N) and the primitives (B, N).

    origin: (B, 3); rays: (B, N, 3), of unit length along the optical axis, both in the world.
    """
    nearest = torch.full(rays.shape[:2], torch.inf, device=rays.device)
    which = torch.zeros(rays.shape[:2], dtype=torch.int64, device=rays.device)
    count = rooms.half.shape[1]
    for k in range(count):
        unit = rooms.axes[:, k] / rooms.half[:, k, None]  # to a cube or a ball of half size 1
        start = ((origin - rooms.centre[:, k])[:, None] @ unit).expand_as(rays)
        step = rays @ unit
        is_ball = k >= count - rooms.ellipsoids
        hit = _ball(start, step) if is_ball else _cube(start, step, from_inside=k == 0)
        nearer = hit < nearest
        nearest, which = torch.where(nearer, hit, nearest), torch.where(nearer, k, which)
    return nearest, which


def _cube(start: Tensor, step: Tensor, from_inside: bool) -> Tensor:
    """Parameters (B, N) at which rays enter the unit cube, or leave it; else infinite."""
    step = torch.where(step.abs() < _TINY, _TINY, step)
    ends = torch.stack([(-1 - start) / step, (1 - start) / step])
    enter, leave = ends.amin(0).amax(-1), ends.amax(0).amin(-1)
    if from_inside:
        return leave
    return enter.masked_fill((enter > leave) | (enter < _NEAR), torch.inf)


def _ball(start: Tensor, step: Tensor) -> Tensor:
    """Parameters (B, N) at which rays enter the unit ball; else infinite.

    With the cross product: b^2 - a c loses half of the digits for a small ball far away.
    """
    square = step.square().sum(-1)
    rest = square - torch.linalg.cross(start, step).square().sum(-1)
    enter = (-(start * step).sum(-1) - rest.clamp(min=0).sqrt()) / square
    return enter.masked_fill((rest < 0) | (enter < _NEAR), torch.inf)


def render(rooms: Rooms, cameras: Cameras, shape: Shape, bank: ImageBank) -> tuple[Tensor, Tensor]:
    """The views (B, 3, H, W) of rooms, RGB in [0, 1], textured with photographs of the bank, and
    their depths (B, H, W)."""
    pixels = pixel_grid(shape, bank.texels.device).flatten(0, 1).expand(len(cameras.K), -1, -1)
    rays = cameras.rays(pixels) @ cameras.pose[..., :3]
    depth, which = first_hits(rooms, cameras.centre, rays)
    room = torch.arange(len(rays), device=which.device)[:, None]
    local = cameras.centre[:, None] + rays * depth[..., None] - rooms.centre[room, which]
    local = torch.einsum("bnji,bnj->bni", rooms.axes[room, which], local)
    axis = (local / rooms.half[room, which]).abs().argmax(-1)
    along = local.gather(-1, axis[..., None])[..., 0]
    face = 2 * axis + (along > 0).long()
    u = torch.where(axis == 0, local[..., 2], local[..., 0])
    v = torch.where(axis == 1, local[..., 2], local[..., 1])
    at = room, which, face
    colours = torch.zeros_like(rays)
    for layer in range(LAYERS):
        photo = rooms.photo[at][..., layer]
        size = bank.size(photo)
        scale = size.amin(-1) / rooms.span[at][..., layer]  # pixels a unit of length
        points = rooms.origin[at][..., layer, :] * size + torch.stack([u, v], -1) * scale[..., None]
        spacing = depth / cameras.K[:, :1] * scale
        colours += rooms.weight[at][..., layer, None] * bank.sample(photo, points, spacing)
    image = (colours * rooms.gain[at]).clamp(0, 1).mT.unflatten(2, shape)
    return image, depth.unflatten(1, shape)


def correspond(
    rooms: Rooms, source: Cameras, target: Cameras, depth: Tensor, points: Tensor, shape: Shape
) -> tuple[Tensor, Tensor]:
    """Where the source, of `shape`, sees the points (B, N, 2), pixels, of the target at depths
    (B, N): their pixels (B, N, 2), exact, and which of them it sees (B, N)."""
    place = target.unproject(points, depth)
    found, away = source.project(place)
    rays = (place - source.centre[:, None]) / away.clamp(min=_NEAR)[..., None]
    seen, _ = first_hits(rooms, source.centre, rays)
    return found, (away > _NEAR) & inside(found, shape) & ((seen / away - 1).abs() < _SAME)


def render_pairs(
    rooms: Rooms, source: Cameras, target: Cameras, shape: Shape, bank: ImageBank
) -> RoomPairs:
    """Pairs of views of `shape` with their exact maps."""
    image1, depth1 = render(rooms, source, shape, bank)
    image2, depth2 = render(rooms, target, shape, bank)
    pixels = pixel_grid(shape, bank.texels.device).flatten(0, 1).expand(len(depth2), -1, -1)
    found, visible = correspond(rooms, source, target, depth2.flatten(1), pixels, shape)
    truth, valid = found.unflatten(1, shape), visible.unflatten(1, shape)
    maps = MapPairs(image1, image2, truth, valid, torch.ones_like(valid))
    return RoomPairs(maps, source, target, depth1, depth2)
