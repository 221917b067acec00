"""Random rooms and yards around their cameras, and pairs of views of them."""

from __future__ import annotations

import math
from dataclasses import dataclass

import torch
import torch.nn.functional as F
from torch import Tensor

from dgc_pose.training.draw import Draw
from dgc_pose.training.photos import Photos
from dgc_pose.training.rooms import (
    FACES,
    LAYERS,
    RoomPairs,
    Rooms,
    correspond,
    first_hits,
    render_pairs,
)
from dgc_pose.training.views import (
    Cameras,
    Shape,
    about_axis,
    middle_of,
    pixel_grid,
    root_area,
)

_PROBE = 24  # rays a side that the views' overlap is estimated by


@dataclass(frozen=True)
class RoomOptions:
    """Ranges of pairs of views of rooms."""

    boxes: int = 11
    ellipsoids: int = 3
    orbit_deg: tuple[float, float] = (4.0, 75.0)  # between the cameras, about what they look at
    roll_deg: float = 7.0  # standard deviation, of each camera
    enough: float = 0.22  # share of the target that the source sees; pairs of more are no better
    tries: int = 3  # pairs drawn for each that is kept
    spans: tuple[tuple[float, float], ...] = ((0.8, 3.0), (0.35, 1.2))  # of a layer's photographs


def room_pairs(
    photos: Photos, count: int, shape: Shape, draw: Draw, options: RoomOptions = RoomOptions()
) -> RoomPairs:
    """Random pairs: of all that are drawn those whose views share the most, up to enough."""
    rooms, look = random_rooms(options.tries * count, photos, draw, options)
    source, target = orbiting(rooms, look, shape, draw, options)
    shared = overlap(rooms, source, target, shape).clamp(max=options.enough)
    best = (shared + 0.02 * draw.uniform(len(shared))).argsort(descending=True)[:count]
    return render_pairs(rooms.chosen(best), source[best], target[best], shape, photos.bank)


def overlap(rooms: Rooms, source: Cameras, target: Cameras, shape: Shape) -> Tensor:
    """The share (B,) of the target's view that the source sees; both of `shape`."""
    grid = pixel_grid((_PROBE, _PROBE), rooms.half.device).flatten(0, 1) + 0.5
    points = grid * grid.new_tensor(shape[::-1]) / _PROBE - 0.5
    points = points.expand(len(target.K), -1, -1)
    rays = target.rays(points) @ target.pose[..., :3]
    depth, _ = first_hits(rooms, target.centre, rays)
    return correspond(rooms, source, target, depth, points, shape)[1].float().mean(1)


def random_rooms(
    count: int, photos: Photos, draw: Draw, options: RoomOptions = RoomOptions()
) -> tuple[Rooms, Tensor]:
    """Random rooms, a quarter of them yards, and what their cameras look at, (B, 3)."""
    solids = options.boxes + options.ellipsoids
    walls = torch.stack([draw.uniform(count, low=low, high=high) for low, high in _WALLS], -1)
    yard = draw.chance(count, 1, share=0.25)
    walls = torch.where(yard, walls * walls.new_tensor((2.5, 3.0, 2.5)), walls)
    low, high = walls.new_tensor(_LOOK).unbind(1)
    look = (low + (high - low) * draw.uniform(count, 3)) * walls.clamp(max=4)
    half = draw.log_uniform(count, solids, 3, low=0.12, high=0.75)
    flat = draw.chance(count, solids, 1, share=0.4)
    thin = draw.integers(count, solids, 1, count=3) == torch.arange(3, device=draw.device)
    half = torch.where(flat & thin, 0.02, half)
    centre = look[:, None] + draw.normal(count, solids, 3) * half.new_tensor((1.0, 0.5, 1.0))
    floor = walls[:, None, 1] - half[..., 1]
    stands = draw.chance(count, solids, share=0.6)
    centre[..., 1] = torch.where(stands, floor, centre[..., 1])
    aligned = draw.chance(count, solids, share=0.4)
    yaw = draw.uniform(count, solids, low=-math.pi, high=math.pi)
    yaw = torch.where(aligned, 0.06 * draw.normal(count, solids), yaw)
    tilted = draw.chance(count, solids, share=0.35)
    pitch, roll = 0.5 * draw.normal(2, count, solids) * tilted
    axes = about_axis(yaw, 1) @ about_axis(pitch, 0) @ about_axis(roll, 2)
    turned = about_axis(0.4 * draw.normal(count, 1), 1)
    shapes = (
        torch.cat([turned, axes], 1),
        torch.cat([walls[:, None], half], 1),
        F.pad(centre, (0, 0, 1, 0)),
    )
    textures = random_textures(count, 1 + solids, photos, draw, options)
    return Rooms(*shapes, *textures, options.ellipsoids), look


_WALLS = ((1.6, 4.5), (1.1, 2.0), (1.6, 4.5))  # half of a room's width, height and depth
_LOOK = ((-0.5, 0.5), (-0.16, 0.48), (-0.5, 0.5))  # of these, what cameras look at


def random_textures(
    count: int, primitives: int, photos: Photos, draw: Draw, options: RoomOptions
) -> tuple[Tensor, Tensor, Tensor, Tensor, Tensor]:
    """Photographs, spans, origins, weights and gains, as `Rooms` has them; half of the primitives
    have one photograph on all faces."""
    faces = count, primitives, FACES
    photo = draw.integers(*faces, LAYERS, count=photos.single)
    photo = torch.where(draw.chance(count, primitives, 1, 1, share=0.5), photo[:, :, :1], photo)
    spans = [draw.log_uniform(*faces, low=low, high=high) for low, high in options.spans]
    span = torch.stack(spans, -1)
    span[:, 0] *= 2
    second = draw.uniform(*faces, high=0.6) * draw.chance(*faces, share=0.65)
    gain = draw.uniform(*faces, 1, low=0.65, high=1.15)
    gain = gain * (1 + 0.12 * draw.normal(count, primitives, 1, 3))
    origin = draw.uniform(*faces, LAYERS, 2)
    return photo, span, origin, torch.stack([1 - second, second], -1), gain


def orbiting(
    rooms: Rooms, look: Tensor, shape: Shape, draw: Draw, options: RoomOptions = RoomOptions()
) -> tuple[Cameras, Cameras]:
    """Two random cameras a room, inside of it, that look at about the points `look` (B, 3)."""
    count = len(look)
    focal = root_area(shape) * draw.uniform(count, 1, low=0.75, high=1.4)
    K = torch.cat([focal, focal, middle_of(shape, draw.device).expand(count, 2)], 1)
    low, high = map(math.radians, options.orbit_deg)
    side = draw.chance(count, share=0.5).float() * 2 - 1
    azimuth = draw.uniform(count, low=-math.pi, high=math.pi)
    elevation = draw.uniform(2, count, low=-0.12, high=0.45)
    distance = draw.log_uniform(count, low=1.3, high=3.5)
    walls, axes = 0.93 * rooms.half[:, 0], rooms.axes[:, 0]
    cameras = []
    for k in range(2):
        if k:
            azimuth = azimuth + side * draw.uniform(count, low=low, high=high)
            distance = distance * draw.log_uniform(count, low=0.7, high=1.42)
        height = torch.lerp(elevation[0], elevation[1], 0.3 * k)
        level = height.cos()
        back = torch.stack([azimuth.sin() * level, -height.sin(), azimuth.cos() * level], -1)
        place = torch.einsum("bji,bj->bi", axes, look + back * distance[:, None])
        centre = torch.einsum("bij,bj->bi", axes, place.minimum(walls).maximum(-walls))
        aside = 0.12 * distance[:, None] * draw.normal(count, 3)
        roll = math.radians(options.roll_deg) * draw.normal(count)
        cameras.append(Cameras.looking(K, centre, look + aside, roll))
    return cameras[0], cameras[1]
