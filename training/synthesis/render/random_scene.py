"""Random scenes around the origin (a room, a table, a background, objects), and their cameras."""

import math

import torch
from torch import Tensor
from torch.nn.functional import normalize

from dgc_pose.training.synthesis.draw import Draw
from dgc_pose.training.synthesis.options import Range, SceneOptions
from dgc_pose.training.synthesis.render.cameras import Cameras, axis_angle, look_at
from dgc_pose.training.synthesis.render.scene import FACES, Layout, Scene

_FOCAL = (0.7, 2.0)  # sides of the view
_FIRST_ROLL_DEG = 5.0  # sigma
_WILD_ROLL_SHARE = 0.1  # of pairs whose roll has 4 times the usual sigma
_LOOK_ASIDE = 0.08  # sigma of the common point's distance from the second optical axis
_FREE_SHARE = 0.15  # of pairs with centre 2 anywhere near centre 1
_UPRIGHT_SHARE = 0.6  # of the boxes and ellipsoids: upright on the table
_LARGE_ONES = 3  # room, background and table come first
_LARGE_SPAN = 1.5  # and their photos are so much larger, to be repeated less often


def random_camera_pair(
    draw: Draw, batch: int, size: int, options: SceneOptions, focal: Range = _FOCAL
) -> tuple[Cameras, Cameras]:
    """B pairs around the origin of the world, by the ranges of the options.

    focal: range of the focal lengths, sides of the view.
    """
    first_K, second_K = (_intrinsics(draw, batch, size, focal) for _ in range(2))
    focal1, focal2 = first_K[:, 0, 0] / size, second_K[:, 0, 0] / size
    distance1 = focal1 * draw.uniform(batch, low=0.8, high=1.5)
    centre1 = distance1[:, None] * random_viewpoints(draw, batch, (-5.0, 60.0))
    roll1 = math.radians(_FIRST_ROLL_DEG) * draw.normal(batch)
    rotation1 = _about_z(roll1) @ look_at(centre1, torch.zeros_like(centre1))

    rotation2 = _relative_rotation(draw, batch, options) @ rotation1
    scale = draw.uniform(batch, low=-options.log_scale, high=options.log_scale).exp()
    distance2 = distance1 * focal2 / focal1 * scale
    aside = _LOOK_ASIDE * draw.normal(batch, 2)
    seen_at = torch.cat((aside, focal2[:, None]), dim=1) * (distance2 / focal2)[:, None]
    orbiting = -(rotation2.mT @ seen_at[..., None])[..., 0]
    step = draw.uniform(batch, 1, low=0.05, high=0.6) * distance1[:, None]
    free = centre1 + step * draw.directions(batch)
    centre2 = torch.where(draw.chance(batch, 1, share=_FREE_SHARE), free, orbiting)

    first = Cameras.at(centre1, first_K, rotation1, (size, size))
    return first, Cameras.at(centre2, second_K, rotation2, (size, size))


def random_viewpoints(draw: Draw, batch: int, elevation_deg: tuple[float, float]) -> Tensor:
    """Unit vectors (B, 3) from the look-at point to a camera; world y points down."""
    low, high = (math.radians(angle) for angle in elevation_deg)
    elevation = draw.uniform(batch, low=low, high=high)
    azimuth = draw.uniform(batch, high=2 * math.pi)
    level = elevation.cos()
    return torch.stack((level * azimuth.sin(), -elevation.sin(), level * azimuth.cos()), dim=-1)


def _relative_rotation(draw: Draw, batch: int, options: SceneOptions) -> Tensor:
    """Camera 2 from camera 1 (B, 3, 3): the optical axis tilted, then a roll."""
    low, high = (math.radians(angle) for angle in options.rotation_deg)
    tilt = draw.uniform(batch, low=low, high=high)
    heading = draw.uniform(batch, high=2 * math.pi)
    axis = torch.stack((heading.cos(), heading.sin(), torch.zeros_like(heading)), dim=-1)
    sigma = math.radians(options.roll_deg)
    wild = draw.chance(batch, share=_WILD_ROLL_SHARE)
    roll = draw.normal(batch) * sigma * (1 + 3 * wild)
    return _about_z(roll) @ axis_angle(axis, tilt)


def _about_z(angle: Tensor) -> Tensor:
    return axis_angle(angle.new_tensor((0.0, 0.0, 1.0)).expand(*angle.shape, 3), angle)


def _intrinsics(draw: Draw, batch: int, size: int, focal_range: Range) -> Tensor:
    """Calibration matrices (B, 3, 3) for square images of `size` pixels."""
    focal = size * draw.log_uniform(batch, low=focal_range[0], high=focal_range[1])
    centre = (size - 1) / 2 + draw.uniform(batch, 2, low=-0.05 * size, high=0.05 * size)
    zero, one = torch.zeros_like(focal), torch.ones_like(focal)
    rows = (focal, zero, centre[:, 0], zero, focal, centre[:, 1], zero, zero, one)
    return torch.stack(rows, dim=-1).unflatten(-1, (3, 3))


def random_scene(
    draw: Draw,
    first: Cameras,
    second: Cameras,
    texture_size: tuple[int, int],
    textures: int,
    options: SceneOptions,
) -> Scene:
    """One scene for each camera pair, built around the cameras so that none is outside the room.

    Primitives: the room; background, table and tilted quads; boxes; ellipsoids.
    """
    batch = len(first.K)
    layout = Layout(1, 2 + options.quads, options.boxes, options.ellipsoids)
    table_height = draw.uniform(batch, low=0.1, high=0.4)
    parts = (
        _room(draw, first.centre, second.centre, table_height),
        _background(draw, first.centre),
        _table(draw, table_height),
        _tilted_quads(draw, first.centre, options.quads),
        _solids(draw, table_height, options.boxes + options.ellipsoids),
    )
    centre, axes, half_size = (torch.cat(tensors, dim=1) for tensors in zip(*parts, strict=True))
    count = sum(layout)
    active = draw.chance(batch, count, share=options.presence)
    active[:, layout.spans()[0]] = True
    texture = texture_maps(draw, batch, count, texture_size, options.texture_span)
    texture[:, :_LARGE_ONES, ..., :2] /= _LARGE_SPAN
    return Scene(
        layout=layout,
        centre=centre,
        axes=axes,
        half_size=half_size,
        active=active,
        photo=draw.integers(batch, count, FACES, count=textures),
        texture=texture,
        light=_light(draw, parts[0]),
    )


Parts = tuple[Tensor, Tensor, Tensor]  # centre (B, n, 3), axes (B, n, 3, 3), half size (B, n, 3)


def _room(draw: Draw, centre1: Tensor, centre2: Tensor, table_height: Tensor) -> Parts:
    reach = draw.uniform(len(centre1), 3, low=0.5, high=0.8)
    low = torch.minimum(torch.minimum(centre1, centre2), -reach)
    high = torch.maximum(torch.maximum(centre1, centre2), reach)
    high[:, 1] = torch.maximum(high[:, 1], table_height)
    low = low - draw.uniform(len(centre1), 3, low=0.05, high=1.0)
    high = high + draw.uniform(len(centre1), 3, low=0.05, high=1.0)
    axes = torch.eye(3, dtype=centre1.dtype, device=centre1.device).expand(len(centre1), 1, 3, 3)
    return (low + high)[:, None] / 2, axes, (high - low)[:, None] / 2


def _background(draw: Draw, centre1: Tensor) -> Parts:
    """A large rectangle behind the look-at point, tilted by up to 45 degrees to the first view."""
    towards = normalize(centre1, dim=-1)[:, None]
    axes = facing(draw, towards, math.radians(45.0))
    behind = draw.uniform(len(centre1), 1, 1, low=0.25, high=1.0)
    return -behind * towards, axes, draw.uniform(len(centre1), 1, 3, low=0.5, high=1.5)


def _table(draw: Draw, height: Tensor) -> Parts:
    zero = torch.zeros_like(height)
    centre = torch.stack((zero, height, zero), dim=-1)[:, None]
    up = torch.stack((zero, zero - 1, zero), dim=-1)[:, None]
    half_size = draw.uniform(len(height), 1, 3, low=0.5, high=1.2)
    return centre, facing(draw, up, 0.0), half_size


def _tilted_quads(draw: Draw, centre1: Tensor, count: int) -> Parts:
    batch = len(centre1)
    towards = normalize(centre1, dim=-1)[:, None].expand(batch, count, 3)
    axes = facing(draw, towards, math.radians(65.0))
    half_size = _object_size(draw, batch, count) * 1.5
    return _around(draw, batch, count), axes, half_size


def _solids(draw: Draw, table_height: Tensor, count: int) -> Parts:
    """Boxes, then ellipsoids: upright on the table, or anywhere in any orientation."""
    batch = len(table_height)
    half_size = _object_size(draw, batch, count)
    centre = _around(draw, batch, count)
    upright = draw.chance(batch, count, share=_UPRIGHT_SHARE)
    standing = table_height[:, None] - half_size[..., 1]
    centre[..., 1] = torch.where(upright, standing, centre[..., 1])
    angle = draw.uniform(batch, count, high=2 * math.pi)
    vertical = angle.new_tensor((0.0, 1.0, 0.0)).expand(batch, count, 3)
    axis = torch.where(upright[..., None], vertical, draw.directions(batch, count))
    return centre, axis_angle(axis, angle), half_size


def _light(draw: Draw, room: Parts) -> Tensor:
    """A light (B, 3) in the upper half of the room, so that no wall shadows it."""
    centre, _, half_size = (part[:, 0] for part in room)
    offset = draw.uniform(len(centre), 3, low=-0.9, high=0.9)
    offset[:, 1] = -offset[:, 1].abs()
    return centre + offset * half_size


def _object_size(draw: Draw, batch: int, count: int) -> Tensor:
    """Half sizes (B, n, 3)."""
    return draw.log_uniform(batch, count, 3, low=0.06, high=0.3)


def _around(draw: Draw, batch: int, count: int) -> Tensor:
    """Points (B, n, 3) around the look-at point."""
    points = draw.uniform(batch, count, 3, low=-0.55, high=0.55)
    points[..., 1] *= 0.5
    return points


def facing(draw: Draw, normal: Tensor, largest: float) -> Tensor:
    """Axes (B, n, 3, 3) whose third is `normal` (B, n, 3), tilted by up to `largest` radians."""
    tilt = draw.uniform(*normal.shape[:-1]) * largest
    third = (axis_angle(_perpendicular(draw, normal), tilt) @ normal[..., None])[..., 0]
    first = _perpendicular(draw, third)
    return torch.stack((first, torch.linalg.cross(third, first), third), dim=-2)


def _perpendicular(draw: Draw, vector: Tensor) -> Tensor:
    """Random unit vectors at right angles to unit vectors (..., 3)."""
    return normalize(torch.linalg.cross(vector, draw.directions(*vector.shape[:-1])), dim=-1)


def texture_maps(
    draw: Draw, batch: int, count: int, size: tuple[int, int], spans: tuple[float, float]
) -> Tensor:
    """Affine maps (B, P, 6, 2, 3) from points on faces to texels: scale, aspect, angle, shift."""
    shape = (batch, count, FACES)
    span = draw.log_uniform(*shape, low=spans[0], high=spans[1])
    density = min(size) / span
    stretch = draw.log_uniform(*shape, low=0.8, high=1.25)
    angle = draw.uniform(*shape, high=2 * math.pi)
    mirror = 1 - 2 * draw.chance(*shape, share=0.5).to(angle.dtype)
    cosine, sine = angle.cos(), angle.sin()
    rows = (
        density * stretch * cosine,
        -density * stretch * sine,
        draw.uniform(*shape, high=size[0]),
        density / stretch * sine * mirror,
        density / stretch * cosine * mirror,
        draw.uniform(*shape, high=size[1]),
    )
    return torch.stack(rows, dim=-1).unflatten(-1, (2, 3))
