"""Rooms: rays, maps and visibility against loops over single rays in float64."""

import math

import numpy as np
import pytest
import torch
from textures import drawn_photos

from dgc_pose.training.draw import Draw
from dgc_pose.training.room_pairs import (
    RoomOptions,
    RoomPairs,
    Rooms,
    first_hits,
    random_rooms,
    room_pairs,
)

RAYS = 150
SHAPE = (48, 64)


@pytest.fixture(scope="module")
def photos():
    return drawn_photos(9, 96)


@pytest.fixture(scope="module")
def pairs(photos):
    return room_pairs(photos, 6, SHAPE, Draw("cpu", 0))


def _cube_parameters(start: np.ndarray, step: np.ndarray) -> list[float]:
    """Where a line meets the surface of the unit cube, by its six planes."""
    found = []
    for axis in range(3):
        for side in (-1.0, 1.0):
            t = (side - start[axis]) / step[axis]
            point = start + t * step
            if all(abs(point[k]) <= 1 for k in range(3) if k != axis):
                found.append(t)
    return sorted(found)


def first_hit(rooms: Rooms, room: int, origin: np.ndarray, ray: np.ndarray) -> tuple[float, int]:
    """The parameter of a ray's first hit, and the primitive."""
    nearest, which = math.inf, 0
    count = rooms.half.shape[1]
    for k in range(count):
        axes, half, centre = (
            part[room, k].double().numpy() for part in (rooms.axes, rooms.half, rooms.centre)
        )
        start, step = (origin - centre) @ axes / half, ray @ axes / half
        if k >= count - rooms.ellipsoids:
            roots = np.roots((step @ step, 2 * start @ step, start @ start - 1))
            found = [] if np.iscomplex(roots).any() else sorted(roots.real)
        else:
            found = _cube_parameters(start, step)
        if not found:
            continue
        t = found[-1] if k == 0 else found[0]
        if 0.05 < t < nearest:
            nearest, which = t, k
    return nearest, which


def test_rays_meet_what_a_loop_finds(photos):
    rooms, look = random_rooms(3, photos, Draw("cpu", 1), RoomOptions(boxes=6, ellipsoids=5))
    rng = np.random.default_rng(0)
    origin = look.numpy() + rng.uniform(-0.5, 0.5, (3, 3)).astype(np.float32)
    rays = rng.standard_normal((3, RAYS, 3)).astype(np.float32)
    found, which = first_hits(rooms, torch.from_numpy(origin), torch.from_numpy(rays))
    expected = [
        [first_hit(rooms, k, origin[k].astype(float), ray.astype(float)) for ray in rays[k]]
        for k in range(3)
    ]
    depth, primitive = (np.array(part) for part in np.moveaxis(np.array(expected), 2, 0))
    same = which.numpy() == primitive
    assert same.mean() > 0.99 and len(np.unique(primitive)) > 8  # a ray may graze an edge
    np.testing.assert_allclose(found.numpy()[same], depth[same], rtol=1e-4)


def _points_in_source(pairs: RoomPairs, k: int) -> tuple[np.ndarray, np.ndarray]:
    """Places (H, W, 2) and depths (H, W) in the source of the target's pixels, by float64."""
    K1, K2 = (c.K[k].double().numpy() for c in (pairs.source, pairs.target))
    pose1, pose2 = (c.pose[k].double().numpy() for c in (pairs.source, pairs.target))
    y, x = np.mgrid[: SHAPE[0], : SHAPE[1]]
    rays = np.stack([(x - K2[2]) / K2[0], (y - K2[3]) / K2[1], np.ones(SHAPE)], -1)
    world = (rays * pairs.depth2[k].double().numpy()[..., None] - pose2[:, 3]) @ pose2[:, :3]
    there = world @ pose1[:, :3].T + pose1[:, 3]
    return there[..., :2] / there[..., 2:] * K1[:2] + K1[2:], there[..., 2]


def test_the_map_is_the_projection_of_the_surface_point_and_visible_means_seen(pairs):
    """The source's depth at the pixels around agrees if visible, and is nearer if hidden."""
    seen = hidden = wrong_seen = wrong_hidden = 0
    for k, depth1 in enumerate(pairs.depth1.numpy()):
        points, depth = _points_in_source(pairs, k)
        shown = pairs.maps.valid[k].numpy()
        ahead = (depth > 0.05) & (np.abs(points).max(-1) < 1000)
        assert np.abs(pairs.maps.map[k].numpy() - points)[ahead].max() < 0.02
        assert not shown[depth < 0].any()
        inside = (depth > 0.05) & (points > 0).all(-1)
        inside &= (points < np.array(SHAPE[::-1]) - 1).all(-1)
        x, y = np.floor(points[inside]).astype(int).T
        around = np.stack([depth1[y + i, x + j] for i in (0, 1) for j in (0, 1)])
        valid, z = shown[inside], depth[inside]
        near, far = 0.97 * around.min(0), 1.03 * around.max(0)
        wrong_seen += (valid & ((z < near) | (z > far))).sum()
        wrong_hidden += (~valid & (z < around.min(0))).sum()
        seen, hidden = seen + valid.sum(), hidden + (~valid).sum()
    assert seen > 3000 and hidden > 300
    assert wrong_seen < 0.005 * seen and wrong_hidden < 0.02 * hidden


def test_cameras_are_as_far_apart_as_asked_and_share_enough(photos):
    options = RoomOptions(orbit_deg=(20.0, 30.0), roll_deg=0.0, enough=0.3, tries=6)
    pairs = room_pairs(photos, 8, SHAPE, Draw("cpu", 4), options)
    R = pairs.target.seen_by(pairs.source).pose[:, :, :3].double()
    angles = torch.rad2deg(torch.acos((R.diagonal(dim1=1, dim2=2).sum(1) - 1) / 2))
    assert angles.min() > 3 and 10 < angles.median() < 40
    assert pairs.maps.valid.float().mean((1, 2)).min() > 0.2
