"""The scene of the bundled demo pair: a corner of a room with a laid table, in metres."""

from __future__ import annotations

import math
from dataclasses import dataclass

import torch
from torch import Tensor

from dgc_pose.synthesis.render.bank import TextureBank
from dgc_pose.synthesis.render.cameras import Cameras, axis_angle, look_at
from dgc_pose.synthesis.render.overlap import Candidate
from dgc_pose.synthesis.render.procedural import Style, procedural_texture
from dgc_pose.synthesis.render.scene import FACES, KINDS, Kind, Layout, Scene

_TEXTURE_SIZE = 640
_WALL_TEXTURE = 3.4  # metres that one texture covers: more than a wall, so none is seen twice
_FLOOR_TEXTURE = 1.6
_LIGHT = (0.9, -2.2, -0.9)
_LOOK_AT = (0.0, -1.0, 0.5)
_CENTRE1 = (-0.55, -1.55, -1.35)
_CENTRE2 = (-0.03, -1.45, -1.45)
_K1 = (820.0, 820.0, 404.3, 296.8)  # fx, fy, cx, cy
_K2 = (760.0, 760.0, 352.1, 325.4)
_ROLL2_DEG = 3.0
_SIZE1 = (800, 600)
_SIZE2 = (720, 640)


@dataclass(frozen=True)
class Thing:
    """One primitive. World y points down, the floor is y = 0."""

    kind: Kind
    centre: tuple[float, float, float]  # metres
    half_size: tuple[float, float, float]  # metres, along its own axes
    textures: tuple[int, ...]  # of the faces -x +x -y +y -z +z, or one for all
    yaw_deg: float = 0.0  # about the vertical
    covers: float | None = None  # metres that one texture covers; None: it fits each face


_TEXTURES: tuple[tuple[Style, int], ...] = (
    ("wood", 29),  # 0: floor
    ("brick", 22),  # 1: side walls
    ("cloud", 28),  # 2: back wall and ceiling
    ("wood", 23),  # 3: table
    ("leaves", 24),  # 4
    ("text", 9),  # 5
    ("pebbles", 10),  # 6
    ("marble", 11),  # 7
    ("checker", 12),  # 8
    ("stripes", 26),  # 9
    ("leaves", 21),  # 10
    ("text", 15),  # 11
    ("leaves", 27),  # 12
)

_THINGS = (
    Thing("room", (-0.2, -1.4, 0.0), (1.7, 1.4, 1.9), (1, 1, 2, 2, 2, 2), covers=_WALL_TEXTURE),
    Thing("box", (-0.2, -0.01, 0.0), (1.69, 0.01, 1.89), (0,), covers=_FLOOR_TEXTURE),
    Thing("quad", (-0.35, -1.75, 1.88), (0.55, 0.38, 1.0), (4,)),
    Thing("quad", (0.85, -1.7, 1.88), (0.34, 0.46, 1.0), (11,)),
    Thing("box", (0.05, -0.74, 0.55), (0.95, 0.03, 0.55), (3,), covers=1.1),
    Thing("box", (-0.8, -0.355, 0.1), (0.04, 0.355, 0.04), (3,), covers=1.1),
    Thing("box", (0.9, -0.355, 0.1), (0.04, 0.355, 0.04), (3,), covers=1.1),
    Thing("box", (-0.8, -0.355, 1.0), (0.04, 0.355, 0.04), (3,), covers=1.1),
    Thing("box", (0.9, -0.355, 1.0), (0.04, 0.355, 0.04), (3,), covers=1.1),
    Thing("box", (-0.48, -0.97, 0.72), (0.15, 0.2, 0.08), (9, 9, 5, 5, 10, 10), yaw_deg=24),
    Thing("box", (0.2, -0.8, 0.28), (0.2, 0.03, 0.14), (5, 5, 5, 5, 5, 5), yaw_deg=-18),
    Thing("box", (0.22, -0.845, 0.29), (0.15, 0.02, 0.11), (9, 9, 12, 12, 9, 9), yaw_deg=12),
    Thing("box", (0.62, -0.93, 0.72), (0.15, 0.16, 0.15), (8, 8, 6, 6, 8, 8), yaw_deg=35),
    Thing("ellipsoid", (0.1, -0.95, 0.75), (0.13, 0.24, 0.13), (7,), yaw_deg=10, covers=0.7),
    Thing("ellipsoid", (-0.2, -0.88, 0.3), (0.13, 0.13, 0.13), (6,), yaw_deg=20, covers=0.6),
    Thing("ellipsoid", (0.63, -0.86, 0.2), (0.16, 0.12, 0.12), (10,), yaw_deg=-15, covers=0.6),
)


def demo_scene() -> Candidate:
    """The scene and its two cameras, float64."""
    return Candidate(
        _scene(),
        _camera(_K1, _CENTRE1, 0.0, _SIZE1),
        _camera(_K2, _CENTRE2, _ROLL2_DEG, _SIZE2),
    )


def demo_textures() -> TextureBank:
    """The textures of the scene."""
    return TextureBank.from_photos(
        torch.stack([procedural_texture(style, _TEXTURE_SIZE, seed) for style, seed in _TEXTURES])
    )


def _scene() -> Scene:
    things = sorted(_THINGS, key=lambda thing: KINDS.index(thing.kind))
    kinds = [thing.kind for thing in things]
    return Scene(
        layout=Layout(*(kinds.count(kind) for kind in KINDS)),
        centre=_tensor([thing.centre for thing in things]),
        axes=torch.stack([_axes(thing) for thing in things])[None],
        half_size=_tensor([thing.half_size for thing in things]),
        active=torch.ones(1, len(things), dtype=torch.bool),
        photo=torch.tensor([_six(thing.textures) for thing in things])[None],
        texture=torch.stack([_texture_maps(thing) for thing in things])[None],
        light=torch.tensor([_LIGHT], dtype=torch.float64),
    )


def _tensor(rows: list[tuple[float, float, float]]) -> Tensor:
    return torch.tensor([rows], dtype=torch.float64)


def _six(textures: tuple[int, ...]) -> tuple[int, ...]:
    return textures * FACES if len(textures) == 1 else textures


def _axes(thing: Thing) -> Tensor:
    vertical = torch.tensor((0.0, 1.0, 0.0), dtype=torch.float64)
    angle = torch.tensor(math.radians(thing.yaw_deg), dtype=torch.float64)
    return axis_angle(vertical, angle).mT


def _texture_maps(thing: Thing) -> Tensor:
    """Affine maps (6, 2, 3) from points of each face to texels, upright on every side."""
    x, y, z = thing.half_size
    maps = []
    for half_u, half_v in ((z, y), (z, y), (x, z), (x, z), (x, y), (x, y)):
        if thing.covers is None:
            across, down = _TEXTURE_SIZE / (2 * half_u), _TEXTURE_SIZE / (2 * half_v)
        else:
            across = down = _TEXTURE_SIZE / thing.covers
        middle = _TEXTURE_SIZE / 2
        maps.append(((across, 0.0, middle), (0.0, down, middle)))
    return torch.tensor(maps, dtype=torch.float64)


def _camera(
    intrinsics: tuple[float, float, float, float],
    centre: tuple[float, float, float],
    roll_deg: float,
    size: tuple[int, int],
) -> Cameras:
    fx, fy, cx, cy = intrinsics
    K = _tensor([(fx, 0.0, cx), (0.0, fy, cy), (0.0, 0.0, 1.0)])
    position = torch.tensor([centre], dtype=torch.float64)
    optical_axis = torch.tensor((0.0, 0.0, 1.0), dtype=torch.float64)
    roll = axis_angle(optical_axis, torch.tensor(math.radians(roll_deg), dtype=torch.float64))
    rotation = roll @ look_at(position, torch.tensor([_LOOK_AT], dtype=torch.float64))
    return Cameras(K, rotation, -(rotation @ position[..., None])[..., 0], size)
