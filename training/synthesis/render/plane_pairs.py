"""Pairs of views of a plane with a relief, whose homography has two poses."""

import math
from dataclasses import replace

import numpy as np
import torch
from torch import Tensor
from torch.nn.functional import normalize

from dgc_pose.geometry.homography import homography_poses
from dgc_pose.geometry.triangulation import depths
from dgc_pose.metrics import rotation_error_deg, translation_error_deg
from dgc_pose.training.synthesis.draw import Draw
from dgc_pose.training.synthesis.options import PhotometricOptions, SceneOptions
from dgc_pose.training.synthesis.photometric import random_photometric
from dgc_pose.training.synthesis.render.bank import TextureBank
from dgc_pose.training.synthesis.render.cameras import Cameras, relative_pose
from dgc_pose.training.synthesis.render.random_scene import facing, random_camera_pair
from dgc_pose.training.synthesis.render.rendered_pairs import RenderedPairs, Views, render_views
from dgc_pose.training.synthesis.render.scene import FACES, Layout, Scene

# Heights of the reliefs, in widths of the plane that view 1 sees
RELIEFS = (0.0, 0.002, 0.005, 0.01, 0.02, 0.05, 0.1, 0.2)
OTHER_DEG = 10.0  # the second pose differs from the true one by more, in R or t

_OPTIONS = SceneOptions(rotation_deg=(15.0, 60.0), roll_deg=5.0, shadow=0.3)
_FOCAL = (0.5 / math.tan(math.radians(35)), 0.5 / math.tan(math.radians(20)))  # sides of the view
_TILT_DEG = 60.0  # of the plane to camera 1, at most
_TILES = 4  # a side: the plane is a wall of photographs
_TILE = (0.5, 0.9)  # side of one
_BOXES, _DOMES = 6, 4
_CLEARANCE = 0.3  # of the cameras, above the plane: the highest relief is below
_FILLS = 0.9  # share of each view that the plane fills, at least
_OVERLAP = 0.4  # share of either view that the other one sees, at least
_PROBE = 20  # shares are estimated on so many rays squared


def render_plane_pair(
    bank: TextureBank, size: int, generator: torch.Generator, relief: float
) -> RenderedPairs:
    """Two views, `size` pixels square, of a plane that one pair of cameras is drawn for.

    See `plane_views`; each view has a light, a blur, noise and a compression of its own.
    """
    draw = Draw(generator, bank.texels.device)
    views = plane_views(draw, size, bank, relief)
    light2 = views.scene.light + _OPTIONS.light_change * draw.normal(1, 3)
    pair = render_views(views, bank, _OPTIONS, light2)
    image1, image2 = (
        random_photometric(image, PhotometricOptions(), generator)
        for image in (pair.image1, pair.image2)
    )
    return replace(pair, image1=image1, image2=image2)


def plane_views(draw: Draw, size: int, bank: TextureBank, relief: float) -> Views:
    """A plane through the origin, covered with photographs, and two cameras that see little else,
    15 to 60 degrees apart and with fields of view of 40 to 70 degrees.

    relief: height of the boxes and domes on the plane, in widths of the plane that view 1 sees; 0
    for none. Cameras and plane are drawn again until its homography has a second pose, more than
    `OTHER_DEG` off, with all points that both views see in front of both cameras.
    """
    while True:
        first, second = random_camera_pair(draw, 1, size, _OPTIONS, _FOCAL)
        ahead = facing(draw, -normalize(first.centre)[:, None], math.radians(_TILT_DEG))[..., 2, :]
        axes = _upright(ahead)
        tile = float(draw.log_uniform(1, low=_TILE[0], high=_TILE[1]))
        if _allows_two_poses(first, second, axes[0, 0], _TILES * tile / 2):
            return Views(_scene(draw, axes, tile, bank, relief), first, second)


def _upright(third: Tensor) -> Tensor:
    """Axes (B, 1, 3, 3) with `third` (B, 1, 3), which leads into the wall; the first is level, to
    the right: photographs hang upright."""
    down = torch.zeros_like(third)
    down[..., 1] = 1
    first = normalize(torch.linalg.cross(down, third), dim=-1)
    return torch.stack((first, torch.linalg.cross(third, first), third), dim=-2)


def _scene(draw: Draw, axes: Tensor, tile: float, bank: TextureBank, relief: float) -> Scene:
    """Coplanar tiles, and boxes and domes on them; `axes` (1, 1, 3, 3) of the plane."""
    solids = _BOXES + _DOMES
    layout = Layout(0, _TILES**2, _BOXES, _DOMES)
    grid = tile * (torch.arange(_TILES, dtype=axes.dtype) - (_TILES - 1) / 2)
    tiles = torch.stack(torch.meshgrid(grid, grid, indexing="xy"), dim=-1).view(1, -1, 2)
    on_plane = torch.cat(
        (tiles.to(axes), draw.uniform(1, solids, 2, low=-0.5, high=0.5).to(axes)), dim=1
    )
    half_size = torch.full((1, sum(layout), 3), tile / 2).to(axes)
    half_size[:, -solids:, :2] = draw.log_uniform(1, solids, 2, low=0.05, high=0.2)
    height = draw.uniform(1, solids, low=0.3, high=1.0)
    kind = int(draw.integers(1, count=3))  # boxes, domes or both
    active = draw.chance(1, sum(layout), share=float(draw.uniform(1)))  # one alone, or many
    active[:, : _TILES**2] = True
    boxes, domes = layout.spans()[2:]
    if kind == 0:
        active[:, domes] = False
    elif kind == 1:
        active[:, boxes] = False
    highest = domes.start if kind == 1 else boxes.start
    height[:, highest - _TILES**2] = 1.0
    active[:, highest] = True
    active[:, _TILES**2 :] &= relief > 0
    half_size[:, -solids:, 2] = max(relief, 1e-6) * height  # from the plane, their middle, up
    texels = min(bank.size) / 2 / half_size[..., :2].amax(-1)  # a unit of length, of all faces
    texture = axes.new_zeros(1, sum(layout), FACES, 2, 3)
    texture[..., 0, 0] = texture[..., 1, 1] = texels[..., None]
    texture[..., 2] = texture.new_tensor(bank.size) / 2
    return Scene(
        layout=layout,
        centre=on_plane @ axes[:, 0, :2],
        axes=axes.expand(1, sum(layout), 3, 3),
        half_size=half_size,
        active=active,
        photo=draw.integers(1, sum(layout), FACES, count=bank.count),
        texture=texture,
        light=draw.uniform(1, 3, low=-1.0, high=1.0).to(axes) - 2 * axes[:, 0, 2],
    )


def _allows_two_poses(first: Cameras, second: Cameras, axes: Tensor, half_size: float) -> bool:
    """Whether the square of `half_size` around the origin, `axes` (3, 3), fills both views, they
    overlap, and its homography has another pose with the points in front of both cameras."""
    away, away2 = (-float(camera.centre[0] @ axes[2]) for camera in (first, second))
    if min(away, away2) < _CLEARANCE:
        return False
    points1, points2, shared = _seen(first, second, axes, half_size)
    _, _, shared2 = _seen(second, first, axes, half_size)
    if min(len(shared), len(shared2)) < _FILLS * _PROBE**2:
        return False
    if min(shared.mean(), shared2.mean()) < _OVERLAP:
        return False
    pose = relative_pose(first, second)[0].double().cpu().numpy()
    R, t = pose[:, :3], pose[:, 3]
    normal = first.rotation[0].double().cpu().numpy() @ axes[2].double().cpu().numpy()
    H = R + np.outer(t, normal) / away  # the plane is normal @ x1 = away
    x1, x2 = points1[shared], points2[shared]
    return any(
        max(rotation_error_deg(R2, R), translation_error_deg(t2, t)) > OTHER_DEG
        and min(np.min(depth) for depth in depths(x1, x2, R2, t2)) > 0
        for R2, t2 in homography_poses(H)
    )


def _seen(
    camera: Cameras, other: Cameras, axes: Tensor, half_size: float
) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Points of the square on a grid of the camera's rays: normalised (n, 2) in the camera and in
    the other one, and a mask of those that the other one sees."""
    width, height = camera.size
    grid = (torch.arange(_PROBE, dtype=camera.K.dtype, device=camera.K.device) + 0.5) / _PROBE
    pixels = torch.stack(torch.meshgrid(grid * width, grid * height, indexing="xy")) - 0.5
    rays = camera.rays(pixels.flatten(1))
    directions = axes @ (camera.rotation.mT @ rays)[0]
    start = axes @ camera.centre[0]
    depth = -start[2] / directions[2]
    across = start[:2, None] + depth * directions[:2]
    on_square = (depth > 0) & (across.abs() <= half_size).all(0)
    rays, depth = rays[..., on_square], depth[on_square]
    pose = relative_pose(camera, other)
    there = pose[..., :3] @ (rays * depth) + pose[..., 3:]
    projected = other.project(there)[0]
    ends = torch.tensor(other.size).to(projected)[:, None] - 1
    inside = (there[0, 2] > 0) & (projected >= 0).all(0) & (projected <= ends).all(0)
    points, moved = (part[0].double().cpu().numpy() for part in (rays, there))
    return points[:2].T, (moved[:2] / moved[2]).T, inside.cpu().numpy()
