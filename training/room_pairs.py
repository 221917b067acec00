"""Random rooms and yards of textured boxes and ellipsoids, and ray-cast pairs of their views."""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import NamedTuple

import torch
import torch.nn.functional as F
from torch import Tensor

from dgc_pose.training.draw import Draw
from dgc_pose.training.photos import ImageBank, Photos
from dgc_pose.training.views import (
    Cameras,
    MapPairs,
    Shape,
    about_axis,
    inside,
    middle_of,
    pixel_grid,
    root_area,
)

FACES = 6  # -x +x -y +y -z +z; for an ellipsoid, the sectors around these axes
LAYERS = 2  # photographs on a face, with different spans: their repetitions do not coincide
_NEAR = 0.05  # units of length; surfaces nearer to a camera are invisible
_SAME = 1e-3  # relative depth by which a surface may be nearer without hiding a point
_ROLL_DEG = 7.0  # standard deviation, of each camera
_TINY = 1e-9  # replaces zeros of directions
_PROBE = 24  # rays per side for estimating the overlap of views
_WALLS = ((1.6, 4.5), (1.1, 2.0), (1.6, 4.5))  # half of a room's width, height and depth
_LOOK = ((-0.5, 0.5), (-0.16, 0.48), (-0.5, 0.5))  # points that cameras look at, in these units
# For each layer, the range of the length that a photograph's shorter side covers, units of length
Spans = tuple[tuple[float, float], ...]


@dataclass(frozen=True)
class RoomOptions:
    boxes: int = 11
    ellipsoids: int = 3
    orbit_deg: tuple[float, float] = (4.0, 75.0)  # angle between the cameras, around their target
    enough: float = 0.22  # share of the target that the source sees; more does not count
    tries: int = 3  # pairs drawn for each kept pair
    spans: Spans = ((0.8, 3.0), (0.35, 1.2))


def room_pairs(
    photos: Photos, count: int, shape: Shape, draw: Draw, options: RoomOptions = RoomOptions()
) -> RoomPairs:
    """Random pairs: the `count` drawn ones whose views overlap most, up to `options.enough`."""
    rooms, look = random_rooms(options.tries * count, photos, draw, options)
    source, target = _orbiting(rooms, look, shape, draw, options)
    shared = overlap(rooms, source, target, shape).clamp(max=options.enough)
    best = (shared + 0.02 * draw.uniform(len(shared))).argsort(descending=True)[:count]
    return render_pairs(rooms.chosen(best), source[best], target[best], shape, photos.bank)


def overlap(rooms: Rooms, source: Cameras, target: Cameras, shape: Shape) -> Tensor:
    """The share (B,) of the target's view that the source sees; both views have `shape`."""
    grid = pixel_grid((_PROBE, _PROBE), rooms.half.device).flatten(0, 1) + 0.5
    points = grid * grid.new_tensor(shape[::-1]) / _PROBE - 0.5
    points = points.expand(len(target.K), -1, -1)
    rays = target.rays(points) @ target.pose[..., :3]
    depth, _ = first_hits(rooms, target.centre, rays)
    return correspond(rooms, source, target, depth, points, shape)[1].float().mean(1)


def random_rooms(
    count: int, photos: Photos, draw: Draw, options: RoomOptions = RoomOptions()
) -> tuple[Rooms, Tensor]:
    """Random rooms, a quarter of them yards, and the points that their cameras look at, (B, 3)."""
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
    stands = draw.chance(count, solids, share=0.6)
    floor = walls[:, None, 1] - half[..., 1]
    centre[..., 1] = torch.where(stands, floor, centre[..., 1])
    aligned = draw.chance(count, solids, share=0.4)
    yaw = draw.uniform(count, solids, low=-math.pi, high=math.pi)
    yaw = torch.where(aligned, 0.06 * draw.normal(count, solids), yaw)
    tilted = draw.chance(count, solids, share=0.35)
    pitch, roll = 0.5 * draw.normal(2, count, solids) * tilted
    axes = about_axis(yaw, 1) @ about_axis(pitch, 0) @ about_axis(roll, 2)
    turned = about_axis(0.4 * draw.normal(count, 1), 1)
    axes = torch.cat([turned, axes], 1)
    half = torch.cat([walls[:, None], half], 1)
    textures = random_textures(count, 1 + solids, photos, draw, options.spans)
    return Rooms(axes, half, F.pad(centre, (0, 0, 1, 0)), *textures, options.ellipsoids), look


def random_textures(
    count: int, primitives: int, photos: Photos, draw: Draw, layers: Spans
) -> tuple[Tensor, Tensor, Tensor, Tensor, Tensor]:
    """Random photographs, spans, origins, weights and gains for `Rooms`; half of the primitives
    have the same photograph on all faces."""
    faces = count, primitives, FACES
    photo = draw.integers(*faces, LAYERS, count=photos.single)
    photo = torch.where(draw.chance(count, primitives, 1, 1, share=0.5), photo[:, :, :1], photo)
    spans = [draw.log_uniform(*faces, low=low, high=high) for low, high in layers]
    span = torch.stack(spans, -1)
    span[:, 0] *= 2
    second = draw.uniform(*faces, high=0.6) * draw.chance(*faces, share=0.65)
    gain = draw.uniform(*faces, 1, low=0.65, high=1.15)
    gain = gain * (1 + 0.12 * draw.normal(count, primitives, 1, 3))
    origin = draw.uniform(*faces, LAYERS, 2)
    return photo, span, origin, torch.stack([1 - second, second], -1), gain


def _orbiting(
    rooms: Rooms, look: Tensor, shape: Shape, draw: Draw, options: RoomOptions
) -> list[Cameras]:
    """Two random cameras inside each room that look roughly at the points `look` (B, 3)."""
    count = len(look)
    focal = root_area(shape) * draw.uniform(count, 1, low=0.75, high=1.4)
    K = torch.cat([focal, focal, middle_of(shape, draw.device).expand(count, 2)], 1)
    low, high = map(math.radians, options.orbit_deg)
    side = draw.chance(count, share=0.5).float() * 2 - 1
    azimuth = draw.uniform(count, low=-math.pi, high=math.pi)
    elevation = draw.uniform(2, count, low=-0.12, high=0.45)
    distance = draw.log_uniform(count, low=1.3, high=3.5)
    walls = 0.93 * rooms.half[:, 0]
    axes = rooms.axes[:, 0]
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
        roll = math.radians(_ROLL_DEG) * draw.normal(count)
        cameras.append(Cameras.looking(K, centre, look + aside, roll))
    return cameras


class Rooms(NamedTuple):
    """B rooms of P primitives: a box seen from inside, boxes, ellipsoids. World y points down."""

    axes: Tensor  # (B, P, 3, 3), world from primitive
    half: Tensor  # (B, P, 3), half sizes along the axes, units of length
    centre: Tensor  # (B, P, 3), world
    photo: Tensor  # (B, P, FACES, LAYERS) int64, index in the bank
    span: Tensor  # (B, P, FACES, LAYERS), length that the photograph's shorter side covers
    origin: Tensor  # (B, P, FACES, LAYERS, 2), point at the face's middle, over the photo's sides
    weight: Tensor  # (B, P, FACES, LAYERS), of the layers' colours; sum 1
    gain: Tensor  # (B, P, FACES, 3), of the colours
    ellipsoids: int  # number of ellipsoids, the last primitives

    def chosen(self, which: Tensor) -> Rooms:
        """Some of the rooms, by index."""
        return Rooms._make([*(part[which] for part in self[:-1]), self.ellipsoids])


@dataclass(frozen=True)
class RoomPairs:
    maps: MapPairs
    source: Cameras
    target: Cameras
    depth1: Tensor  # (B, H, W), of the source along the optical axis, units of length
    depth2: Tensor  # (B, H, W), of the target


def first_hits(rooms: Rooms, origin: Tensor, rays: Tensor) -> tuple[Tensor, Tensor]:
    """Where rays first hit a surface: ray parameters (B, N) and primitives (B, N).

    origin: (B, 3); rays: (B, N, 3), with z = 1 in the camera; both in world coordinates.
    """
    nearest = torch.full_like(rays[..., 0], torch.inf)
    which = torch.zeros_like(nearest, dtype=torch.int64)
    count = rooms.half.shape[1]
    for k in range(count):
        unit = rooms.axes[:, k] / rooms.half[:, k, None]  # maps to a cube or a ball of half size 1
        start = ((origin - rooms.centre[:, k])[:, None] @ unit).expand_as(rays)
        step = rays @ unit
        is_ball = k >= count - rooms.ellipsoids
        hit = _ball(start, step) if is_ball else _cube(start, step, from_inside=k == 0)
        nearer = hit < nearest
        nearest = torch.where(nearer, hit, nearest)
        which = torch.where(nearer, k, which)
    return nearest, which


def _cube(start: Tensor, step: Tensor, from_inside: bool) -> Tensor:
    """Parameters (B, N) at which rays enter (`from_inside`: leave) the unit cube, or infinity."""
    step = torch.where(step.abs() < _TINY, _TINY, step)
    ends = torch.stack([(-1 - start) / step, (1 - start) / step])
    enter = ends.amin(0).amax(-1)
    leave = ends.amax(0).amin(-1)
    if from_inside:
        return leave
    return enter.masked_fill((enter > leave) | (enter < _NEAR), torch.inf)


def _ball(start: Tensor, step: Tensor) -> Tensor:
    """Parameters (B, N) at which rays enter the unit ball, or infinity.

    Uses the cross product, since b^2 - a c loses half of the digits for a small ball far away.
    """
    square = step.square().sum(-1)
    rest = square - torch.linalg.cross(start, step).square().sum(-1)
    enter = (-(start * step).sum(-1) - rest.clamp(min=0).sqrt()) / square
    return enter.masked_fill((rest < 0) | (enter < _NEAR), torch.inf)


def render(rooms: Rooms, cameras: Cameras, shape: Shape, bank: ImageBank) -> tuple[Tensor, Tensor]:
    """Render rooms, textured with photographs of the bank: views (B, 3, H, W), RGB in [0, 1], and
    depths (B, H, W)."""
    pixels = pixel_grid(shape, bank.texels.device).flatten(0, 1).expand(len(cameras.K), -1, -1)
    rays = cameras.rays(pixels) @ cameras.pose[..., :3]
    depth, which = first_hits(rooms, cameras.centre, rays)
    room = torch.arange(len(rays), device=which.device)[:, None]
    local = cameras.centre[:, None] + rays * depth[..., None] - rooms.centre[room, which]
    local = torch.einsum("bnji,bnj->bni", rooms.axes[room, which], local)
    axis = (local / rooms.half[room, which]).abs().argmax(-1)
    along = local.gather(-1, axis[..., None])[..., 0]
    at = room, which, 2 * axis + (along > 0).long()
    x, y, z = local.unbind(-1)
    on_face = torch.stack([torch.where(axis == 0, z, x), torch.where(axis == 1, z, y)], -1)
    colours = torch.zeros_like(rays)
    for layer in range(LAYERS):
        photo = rooms.photo[at][..., layer]
        size = bank.size(photo)
        scale = size.amin(-1) / rooms.span[at][..., layer]  # pixels per unit of length
        points = rooms.origin[at][..., layer, :] * size + on_face * scale[..., None]
        spacing = depth / cameras.K[:, :1] * scale
        colours += rooms.weight[at][..., layer, None] * bank.sample(photo, points, spacing)
    image = (colours * rooms.gain[at]).clamp(0, 1).mT.unflatten(2, shape)
    return image, depth.unflatten(1, shape)


def correspond(
    rooms: Rooms, source: Cameras, target: Cameras, depth: Tensor, points: Tensor, shape: Shape
) -> tuple[Tensor, Tensor]:
    """Project points (B, N, 2), pixels of the target at depths (B, N), to the source, of `shape`:
    exact pixels (B, N, 2), and whether the source sees each point (B, N)."""
    place = target.unproject(points, depth)
    found, away = source.project(place)
    rays = (place - source.centre[:, None]) / away.clamp(min=_NEAR)[..., None]
    seen, _ = first_hits(rooms, source.centre, rays)
    return found, (away > _NEAR) & inside(found, shape) & ((seen / away - 1).abs() < _SAME)


def render_pairs(
    rooms: Rooms,
    source: Cameras,
    target: Cameras,
    shape: Shape,
    bank: ImageBank,
    source_shape: Shape | None = None,
) -> RoomPairs:
    """Render pairs of views of `shape` (source: `source_shape` if given) with their exact maps."""
    shape1 = source_shape or shape
    image1, depth1 = render(rooms, source, shape1, bank)
    image2, depth2 = render(rooms, target, shape, bank)
    pixels = pixel_grid(shape, bank.texels.device).flatten(0, 1).expand(len(depth2), -1, -1)
    found, visible = correspond(rooms, source, target, depth2.flatten(1), pixels, shape1)
    truth = found.unflatten(1, shape)
    valid = visible.unflatten(1, shape)
    maps = MapPairs(image1, image2, truth, valid, torch.ones_like(valid))
    return RoomPairs(maps, source, target, depth1, depth2)
