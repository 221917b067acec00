"""Pairs of views of a plane with a relief, whose homography has two poses."""

import math
from dataclasses import replace

import numpy as np
import torch
import torch.nn.functional as F

from dgc_pose.geometry.homography import homography_poses
from dgc_pose.geometry.triangulation import depths
from dgc_pose.metrics import rotation_error_deg, translation_error_deg
from dgc_pose.training.draw import Draw
from dgc_pose.training.light import other_light
from dgc_pose.training.photos import Photos
from dgc_pose.training.room_pairs import (
    RoomOptions,
    RoomPairs,
    Rooms,
    random_textures,
    render_pairs,
)
from dgc_pose.training.views import Cameras, inside, middle_of, pixel_grid

# Heights of the reliefs, in widths of the plane that view 1 sees
RELIEFS = (0.0, 0.002, 0.005, 0.01, 0.02, 0.05, 0.1, 0.2)
OTHER_DEG = 10.0  # the second pose differs from the true one by more, in R or t

_TILT_DEG = 60.0  # of the plane to camera 1, at most
_ANGLE_DEG = (15.0, 60.0)  # between the optical axes
_ROLL_DEG = 5.0  # standard deviation
_FIELD_DEG = (40.0, 70.0)  # of view
_TILES = 4  # a side: the plane is a wall of photographs
_TILE = (0.5, 0.9)  # side of one
_BOXES, _DOMES = 6, 4
_BEHIND = 0.01  # half of the tiles' thickness
_CLEARANCE = 0.3  # of the cameras, above the plane: the highest relief is below
_FILLS = 0.9  # share of each view that the plane fills, at least
_OVERLAP = 0.4  # share of either view that the other one sees, at least
_PROBE = 20  # shares are estimated on so many rays squared
_HALL = 50.0  # half side of the room around it all


def plane_pair(photos: Photos, size: int, draw: Draw, relief: float) -> RoomPairs:
    """Two views, `size` pixels square, of a plane in z = 0 of the world, covered with photographs
    and seen from z < 0, each in a light of its own.

    relief: height of the boxes and domes on the plane, in widths of the plane that view 1 sees; 0
    for none. Cameras and plane are drawn again until its homography has a second pose, more than
    `OTHER_DEG` off, with all points that both views see in front of both cameras.
    """
    while True:
        tile = float(draw.log_uniform(1, low=_TILE[0], high=_TILE[1]))
        first, second = _cameras(draw, size)
        if _allows_two_poses(first, second, size, _TILES * tile / 2):
            break
    rooms = _wall(photos, draw, tile, relief)
    pair = render_pairs(rooms, first, second, (size, size), photos.bank)
    views = other_light(torch.cat([pair.maps.image1, pair.maps.image2]), draw)
    return replace(pair, maps=pair.maps._replace(image1=views[:1], image2=views[1:]))


def _cameras(draw: Draw, size: int) -> tuple[Cameras, Cameras]:
    """Two cameras that look at about the origin, where the first sees a width of 1."""
    directions = F.normalize(draw.normal(2, 3), dim=-1) - torch.tensor([0.0, 0.0, 2.0])
    field = torch.deg2rad(draw.uniform(2, low=_FIELD_DEG[0], high=_FIELD_DEG[1]))
    focal = 0.5 / (field / 2).tan()
    distance = focal * draw.log_uniform(2, low=0.8, high=1.3)
    distance[0] = focal[0]
    middle = middle_of((size, size), draw.device).expand(2, 2)
    K = torch.cat([size * focal[:, None].expand(2, 2), middle], 1)
    centre = F.normalize(directions, dim=-1) * distance[:, None]
    look = 0.08 * draw.normal(2, 3) * torch.tensor([1.0, 1.0, 0.0])
    both = Cameras.looking(K, centre, look, math.radians(_ROLL_DEG) * draw.normal(2))
    return both[:1], both[1:]


def _wall(photos: Photos, draw: Draw, tile: float, relief: float) -> Rooms:
    """Coplanar tiles, and boxes and domes on them, in a large hall."""
    count = _TILES**2 + _BOXES + _DOMES
    grid = tile * (torch.arange(_TILES) - (_TILES - 1) / 2)
    tiles = torch.stack(torch.meshgrid(grid, grid, indexing="xy"), -1).view(-1, 2)
    solids = draw.uniform(_BOXES + _DOMES, 2, low=-0.5, high=0.5)
    sides = draw.log_uniform(_BOXES + _DOMES, 2, low=0.05, high=0.2)
    # Boxes, domes or both; one alone, or many; the first that is there is the highest.
    there = draw.chance(_BOXES + _DOMES, share=float(draw.uniform(1)))
    kind = draw.choice(("boxes", "domes", "both"))
    there[: _BOXES if kind == "domes" else 0] = False
    there[_BOXES if kind == "boxes" else len(there) :] = False
    highest = _BOXES if kind == "domes" else 0
    height = relief * draw.uniform(_BOXES + _DOMES, low=0.3)
    there[highest], height[highest] = True, relief
    there &= relief > 0
    is_box = torch.arange(len(height)) < _BOXES  # which reach from within the tiles up
    half_z = torch.where(is_box, (height + _BEHIND) / 2, height)
    middle_z = torch.where(is_box, (_BEHIND - height) / 2, 0 * height)
    centre = torch.cat(
        [F.pad(tiles, (0, 1), value=_BEHIND), torch.column_stack([solids, middle_z])]
    )
    tile_half = torch.tensor([[tile / 2, tile / 2, _BEHIND]]).expand(_TILES**2, 3)
    half = torch.cat([tile_half, torch.column_stack([sides, half_z])])
    options = RoomOptions(spans=((tile, tile * 1.001), (tile, tile * 1.001)))
    photo, span, origin, weight, gain = random_textures(1, 1 + count, photos, draw, options)
    rooms = Rooms(
        torch.eye(3).expand(1, 1 + count, 3, 3),
        F.pad(half, (0, 0, 1, 0), value=_HALL)[None],
        F.pad(centre, (0, 0, 1, 0))[None],
        photo,
        span,
        torch.full_like(origin, 0.5),
        torch.tensor([1.0, 0.0]).expand_as(weight),
        gain,
        int(there[_BOXES:].sum()),
    )
    kept = torch.cat([torch.ones(1 + _TILES**2).bool(), there])
    parts = rooms._asdict().items()
    return rooms._replace(**{k: part[:, kept] for k, part in parts if k != "ellipsoids"})


def _allows_two_poses(first: Cameras, second: Cameras, size: int, half_side: float) -> bool:
    """Whether the square of `half_side` around the origin fills both views, they overlap at the
    angle asked for, and its homography has another pose with the points in front of both
    cameras."""
    away = -float(first.centre[0, 2])
    axes = torch.cat([first.pose[:, 2, :3], second.pose[:, 2, :3]])
    angle = math.degrees(math.acos(min(1.0, float(axes[0] @ axes[1]))))
    tilt = math.degrees(math.acos(float(axes[0, 2])))
    if not (_ANGLE_DEG[0] <= angle <= _ANGLE_DEG[1] and tilt <= _TILT_DEG):
        return False
    if min(away, -float(second.centre[0, 2])) < _CLEARANCE:
        return False
    points1, points2, shared = _seen(first, second, size, half_side)
    shared2 = _seen(second, first, size, half_side)[2]
    if min(len(shared), len(shared2)) < _FILLS * _PROBE**2:
        return False
    if min(shared.mean(), shared2.mean()) < _OVERLAP:
        return False
    pose = second.seen_by(first).pose[0].double().numpy()
    R, t = pose[:, :3], pose[:, 3]
    # The plane: normal @ x1 = away
    H = R + np.outer(t, first.pose[0, :, 2].double().numpy()) / away
    x1, x2 = points1[shared], points2[shared]
    return any(
        max(rotation_error_deg(R2, R), translation_error_deg(t2, t)) > OTHER_DEG
        and min(np.min(depth) for depth in depths(x1, x2, R2, t2)) > 0
        for R2, t2 in homography_poses(H)
    )


def _seen(
    camera: Cameras, other: Cameras, size: int, half_side: float
) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Points of the square on a grid of the camera's rays: normalised (n, 2) in the camera and in
    the other one, and a mask of those that the other one sees."""
    grid = pixel_grid((_PROBE, _PROBE), camera.K.device).view(1, -1, 2)
    rays = camera.rays(grid * size / (_PROBE - 1) - 0.5)  # to the edges
    turned = rays @ camera.pose[..., :3]
    depth = -camera.centre[:, None, 2] / turned[..., 2]
    place = camera.centre[:, None] + turned * depth[..., None]
    on_square = (depth[0] > 0) & (place[0, :, :2].abs() <= half_side).all(-1)
    seen, ahead = other.project(place[:, on_square])
    normalised = other.rays(seen)[0, :, :2]
    shown = (ahead[0] > 0) & inside(seen[0], (size, size))
    parts = rays[0, on_square, :2].double(), normalised.double(), shown
    points1, points2, mask = (part.numpy() for part in parts)
    return points1, points2, mask
