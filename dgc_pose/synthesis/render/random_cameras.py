"""Random pairs of cameras that look at about the same point."""

from __future__ import annotations

import math

import torch
from torch import Tensor

from dgc_pose.synthesis.draw import Draw
from dgc_pose.synthesis.options import SceneOptions
from dgc_pose.synthesis.render.cameras import Cameras, axis_angle, look_at

_FIRST_ROLL_DEG = 5.0  # sigma
_WILD_ROLL_SHARE = 0.1  # of pairs whose roll has 4 times the usual sigma
_LOOK_ASIDE = 0.08  # sigma of the common point's distance from the second optical axis
_FREE_SHARE = 0.15  # of pairs with centre 2 anywhere near centre 1


def _intrinsics(draw: Draw, batch: int, size: int) -> Tensor:
    """Calibration matrices (B, 3, 3) for square images of `size` pixels."""
    focal = size * draw.log_uniform(batch, low=0.7, high=2.0)
    centre = (size - 1) / 2 + draw.uniform(batch, 2, low=-0.05 * size, high=0.05 * size)
    zero, one = torch.zeros_like(focal), torch.ones_like(focal)
    rows = (focal, zero, centre[:, 0], zero, focal, centre[:, 1], zero, zero, one)
    return torch.stack(rows, dim=-1).unflatten(-1, (3, 3))


def random_camera_pair(
    draw: Draw, batch: int, size: int, options: SceneOptions
) -> tuple[Cameras, Cameras]:
    """B pairs around the origin of the world, by the ranges of the options."""
    first_K, second_K = (_intrinsics(draw, batch, size) for _ in range(2))
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
    axis = angle.new_tensor((0.0, 0.0, 1.0)).expand(*angle.shape, 3)
    return axis_angle(axis, angle)
