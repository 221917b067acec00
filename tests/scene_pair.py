"""One pair of views of a seeded scene with procedural textures, as NumPy arrays."""

import math
from functools import lru_cache
from typing import Literal

import torch
from procedural import procedural_textures
from torch import Tensor
from torch.nn.functional import normalize

from dgc_pose.training.synthesis.draw import Draw
from dgc_pose.training.synthesis.options import SceneOptions
from dgc_pose.training.synthesis.render.bank import TextureBank
from dgc_pose.training.synthesis.render.cameras import Cameras, axis_angle, look_at
from dgc_pose.training.synthesis.render.random_scene import (
    facing,
    random_scene,
    random_viewpoints,
    texture_maps,
)
from dgc_pose.training.synthesis.render.rendered_pairs import (
    RenderedPair,
    Views,
    as_arrays,
    overlapping,
    render_views,
)
from dgc_pose.training.synthesis.render.scene import FACES, Layout, Scene

PairKind = Literal["general", "planar", "rotation_only", "forward"]

_OPTIONS = SceneOptions(
    presence=0.9, texture_span=(0.45, 0.9), min_overlap=0.5, tries=12, shadow=0.3
)
_DISTANCE = 1.2  # from the look-at point, fields of view
_PLANE_HALF_SIZE = 20.0
_PLANE_SPAN = (1.0, 1.3)  # fields of view that the texture of the plane covers
_PLANE_TEXTURE = 0  # leaves: not periodic, so that no two points of the plane look alike


def render_scene_pair(
    seed: int,
    *,
    size1: tuple[int, int] = (320, 240),
    size2: tuple[int, int] = (320, 240),
    rotation_deg: float = 15.0,
    kind: PairKind = "general",
) -> RenderedPair:
    """A pair whose cameras differ by a rotation of exactly `rotation_deg` and have their own K.

    Sizes are (width, height). kind: "general", objects in a room, orbited; "planar", the same
    motion before a single plane; "rotation_only", the room from one centre; "forward", the room
    with camera 2 ahead of camera 1 on its optical axis. The same seed gives the same pair.
    """
    draw = Draw(torch.Generator().manual_seed(seed), dtype=torch.float64)
    bank = _bank()

    def draw_views() -> Views:
        first, second = _camera_pair(draw, size1, size2, math.radians(rotation_deg), kind)
        if kind == "planar":
            scene = _single_plane(draw, first, bank.size, _PLANE_TEXTURE)
        else:
            scene = random_scene(draw, first, second, bank.size, bank.count, _OPTIONS)
        return Views(scene, first, second)

    views = overlapping(draw_views, _OPTIONS)
    return as_arrays(render_views(views, bank, _OPTIONS, views.scene.light))


def _single_plane(draw: Draw, first: Cameras, texture_size: tuple[int, int], photo: int) -> Scene:
    """For each camera one plane through the origin that fills its view, tilted by up to 30 deg.

    Its texture is `photo`, with the middle at the origin.
    """
    batch = len(first.K)
    towards = normalize(first.centre, dim=-1)[:, None]
    texture = texture_maps(draw, batch, 1, texture_size, _PLANE_SPAN)
    texture[..., 2] = texture.new_tensor(texture_size) / 2
    return Scene(
        layout=Layout(0, 1, 0, 0),
        centre=torch.zeros_like(towards),
        axes=facing(draw, towards, math.radians(30.0)),
        half_size=torch.full_like(towards, _PLANE_HALF_SIZE),
        active=torch.ones_like(towards[..., 0], dtype=torch.bool),
        photo=torch.full((batch, 1, FACES), photo, device=towards.device),
        texture=texture,
        light=first.centre,
    )


@lru_cache(maxsize=1)
def _bank() -> TextureBank:
    return TextureBank.from_photos(procedural_textures(18, 384))


def _camera_pair(
    draw: Draw, size1: tuple[int, int], size2: tuple[int, int], rotation: float, kind: PairKind
) -> tuple[Cameras, Cameras]:
    K1, K2 = _intrinsics(draw, size1), _intrinsics(draw, size2)
    viewpoint = random_viewpoints(draw, 1, (15.0, 40.0))
    centre1 = viewpoint * _DISTANCE * K1[:, 0, 0, None] / max(size1)
    rotation1 = look_at(centre1, torch.zeros_like(centre1))

    tilt = draw.normal(1, 3) * 0.3
    tilt[:, 1] = 1 - 2 * draw.chance(1, share=0.5).to(tilt.dtype)
    angle = torch.full_like(tilt[:, 0], rotation)
    rotation2 = axis_angle(normalize(tilt, dim=-1), angle) @ rotation1
    if kind == "rotation_only":
        centre2 = centre1
    elif kind == "forward":
        centre2 = centre1 * (1 - 0.3)
    else:
        distance2 = draw.uniform(1, 1, low=0.9, high=1.1) * _DISTANCE * K2[:, 0, 0] / max(size2)
        centre2 = -distance2 * rotation2[:, 2]
    first = Cameras.at(centre1, K1, rotation1, size1)
    return first, Cameras.at(centre2, K2, rotation2, size2)


def _intrinsics(draw: Draw, size: tuple[int, int]) -> Tensor:
    focal = max(size) * draw.uniform(low=1.0, high=1.4)
    K = torch.eye(3, dtype=focal.dtype)
    K[0, 0] = K[1, 1] = focal
    K[:2, 2] = (torch.tensor(size) - 1) / 2 + max(size) * draw.uniform(2, low=-0.03, high=0.03)
    return K[None]
