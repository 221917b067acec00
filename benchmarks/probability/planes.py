"""Pairs of views of a plane with a relief, whose homography has two poses."""

import math
from dataclasses import replace

import numpy as np
import torch
import torch.nn.functional as F

from dgc_pose.geometry.epipolar import depths
from dgc_pose.geometry.homography import homography_poses
from dgc_pose.metrics import rotation_error_deg, translation_error_deg
from dgc_pose.training.draw import Draw, other_light
from dgc_pose.training.photos import Photos
from dgc_pose.training.room_pairs import (
    RoomPairs,
    Rooms,
    correspond,
    first_hits,
    random_textures,
    render_pairs,
)
from dgc_pose.training.views import Cameras, middle_of, pixel_grid

# Heights of the relief, in units of the width of the plane in view 1
RELIEFS = (0.0, 0.002, 0.005, 0.01, 0.02, 0.05, 0.1, 0.2)
OTHER_DEG = 10.0  # least difference of the second pose from the true one, in R or t

_ANGLE_DEG = (15.0, 60.0)  # between the optical axes
_ROLL_DEG = 5.0  # standard deviation
_FIELD_DEG = (40.0, 70.0)  # of view
_TILES = 4  # per side: the plane is a wall of photographs
_TILE = (0.5, 0.9)  # side of a tile
_BOXES = 6  # on the plane, at most
_BEHIND = 0.01  # half of the tiles' thickness
_FILLS = 0.9  # least share of each view that the plane fills
_OVERLAP = 0.4  # least share of each view that the other one sees
_PROBE = 20  # rays per side to estimate these shares
_HALL = 50.0  # half side of the room around the plane


def plane_pair(photos: Photos, size: int, draw: Draw, relief: float) -> RoomPairs:
    """Render two views, `size` pixels square, of a plane at z = 0, covered with photographs and
    seen from z < 0, each in random light.

    relief: height of the boxes on the plane, in units of the width of the plane in view 1; 0 for no
    boxes. Cameras and plane are drawn until the homography has a second pose, more than `OTHER_DEG`
    away, with all common points in front of both cameras.
    """
    allowed = False
    while not allowed:
        tile = float(draw.log_uniform(1, low=_TILE[0], high=_TILE[1]))
        first, second = _cameras(draw, size)
        flat = _wall(photos, draw, tile, 0.0)
        allowed = _allows_two_poses(flat, first, second, size)
    rooms = _wall(photos, draw, tile, relief)
    pair = render_pairs(rooms, first, second, (size, size), photos.bank)
    views = other_light(torch.cat([pair.maps.image1, pair.maps.image2]), draw)
    return replace(pair, maps=pair.maps._replace(image1=views[:1], image2=views[1:]))


def _cameras(draw: Draw, size: int) -> tuple[Cameras, Cameras]:
    """Two cameras that look roughly at the origin, where the view of the first is 1 wide."""
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
    """Coplanar tiles in a large hall, with boxes on them, one of the height `relief`."""
    boxes = 1 + int(draw.integers(1, count=_BOXES)) if relief else 0
    grid = tile * (torch.arange(_TILES) - (_TILES - 1) / 2)
    tiles = torch.stack(torch.meshgrid(grid, grid, indexing="xy"), -1).view(-1, 2)
    height = relief * draw.uniform(boxes, low=0.3)
    height[:1] = relief
    # The boxes begin inside the tiles
    middle = [draw.uniform(boxes, 2, low=-0.5, high=0.5), (_BEHIND - height) / 2]
    sides = [draw.log_uniform(boxes, 2, low=0.05, high=0.2), (height + _BEHIND) / 2]
    centre = torch.cat([F.pad(tiles, (0, 1), value=_BEHIND), torch.column_stack(middle)])
    tiles_half = torch.tensor([[tile / 2, tile / 2, _BEHIND]]).expand(_TILES**2, 3)
    half = torch.cat([tiles_half, torch.column_stack(sides)])
    spans = ((tile, tile * 1.001),) * 2
    count = 1 + len(half)
    photo, span, origin, weight, gain = random_textures(1, count, photos, draw, spans)
    return Rooms(
        torch.eye(3).expand(1, count, 3, 3),
        F.pad(half, (0, 0, 1, 0), value=_HALL)[None],
        F.pad(centre, (0, 0, 1, 0))[None],
        photo,
        span,
        torch.full_like(origin, 0.5),
        torch.tensor([1.0, 0.0]).expand_as(weight),
        gain,
        0,
    )


def _allows_two_poses(flat: Rooms, first: Cameras, second: Cameras, size: int) -> bool:
    """Whether the plane fills both views, these overlap at an angle in `_ANGLE_DEG`, and the
    homography has another pose with the points in front of both cameras."""
    pose = second.seen_by(first).pose[0].double().numpy()
    R = pose[:, :3]
    t = pose[:, 3]
    if not _ANGLE_DEG[0] <= math.degrees(math.acos(min(1.0, R[2, 2]))) <= _ANGLE_DEG[1]:
        return False
    grid = pixel_grid((_PROBE, _PROBE), first.K.device).view(1, -1, 2) * size / (_PROBE - 1) - 0.5
    for source, target in ((second, first), (first, second)):
        depth, which = first_hits(flat, target.centre, target.rays(grid) @ target.pose[..., :3])
        found, seen = correspond(flat, source, target, depth, grid, (size, size))
        shared = seen & (which > 0)  # 0 is the hall
        if (which > 0).float().mean() < _FILLS or shared.float().mean() < _OVERLAP:
            return False
    x1, x2 = (
        rays[shared][:, :2].double().numpy() for rays in (first.rays(found), second.rays(grid))
    )
    # The plane: normal @ x1 = away
    normal = first.pose[0, :, 2].double().numpy()
    away = -float(first.centre[0, 2])
    return any(
        max(rotation_error_deg(R2, R), translation_error_deg(t2, t)) > OTHER_DEG
        and min(np.min(depth) for depth in depths(x1, x2, R2, t2)) > 0
        for R2, t2 in homography_poses(R + np.outer(t, normal) / away)
    )
