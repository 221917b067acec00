"""Rooms: maps and visibility by the other view's depth, in float64."""

import math

import numpy as np
import pytest
import torch
from textures import drawn_photos

from dgc_pose.training.draw import Draw
from dgc_pose.training.room_pairs import RoomOptions, first_hits, random_rooms, room_pairs

SHAPE = (48, 64)


@pytest.fixture(scope="module")
def photos():
    return drawn_photos(9, 96)


def _cube_parameters(start: np.ndarray, step: np.ndarray) -> list[float]:
    """Where a line meets the surface of the unit cube, by its six planes."""
    found = []
    for axis in range(3):
        for side in (-1.0, 1.0):
            t = (side - start[axis]) / step[axis]
            if (np.abs(np.delete(start + t * step, axis)) <= 1).all():
                found.append(t)
    return sorted(found)


def test_the_map_is_the_projection_of_the_surface_point_and_visible_means_seen(photos):
    """The source's depth at the pixels around agrees if visible, and is nearer if hidden."""
    pairs = room_pairs(photos, 6, SHAPE, Draw("cpu", 0))
    seen = hidden = wrong_seen = wrong_hidden = 0
    y, x = np.mgrid[: SHAPE[0], : SHAPE[1]]
    for k, depth1 in enumerate(pairs.depth1.numpy()):
        K1, pose1, K2, pose2 = (
            part[k].double().numpy()
            for camera in (pairs.source, pairs.target)
            for part in (camera.K, camera.pose)
        )
        rays = np.stack([(x - K2[2]) / K2[0], (y - K2[3]) / K2[1], np.ones(SHAPE)], -1)
        world = (rays * pairs.depth2[k].double().numpy()[..., None] - pose2[:, 3]) @ pose2[:, :3]
        there = world @ pose1[:, :3].T + pose1[:, 3]
        points, depth = there[..., :2] / there[..., 2:] * K1[:2] + K1[2:], there[..., 2]
        shown = pairs.maps.valid[k].numpy()
        ahead = (depth > 0.05) & (np.abs(points).max(-1) < 1000)
        assert np.abs(pairs.maps.map[k].numpy() - points)[ahead].max() < 0.02
        assert not shown[depth < 0].any()
        inside = (depth > 0.05) & (points > 0).all(-1)
        inside &= (points < np.array(SHAPE[::-1]) - 1).all(-1)
        columns, rows = np.floor(points[inside]).astype(int).T
        around = np.stack([depth1[rows + i, columns + j] for i in (0, 1) for j in (0, 1)])
        valid, z = shown[inside], depth[inside]
        wrong_seen += (valid & ((z < 0.97 * around.min(0)) | (z > 1.03 * around.max(0)))).sum()
        wrong_hidden += (~valid & (z < around.min(0))).sum()
        seen, hidden = seen + valid.sum(), hidden + (~valid).sum()
    assert seen > 3000 and hidden > 300
    assert wrong_seen < 0.005 * seen and wrong_hidden < 0.02 * hidden


def test_cameras_are_as_far_apart_as_asked_and_share_enough(photos):
    options = RoomOptions(orbit_deg=(20.0, 30.0), enough=0.3, tries=6)
    pairs = room_pairs(photos, 8, SHAPE, Draw("cpu", 4), options)
    R = pairs.target.seen_by(pairs.source).pose[:, :, :3].double()
    angles = torch.rad2deg(torch.acos((R.diagonal(dim1=1, dim2=2).sum(1) - 1) / 2))
    assert angles.min() > 3 and 10 < angles.median() < 40
    assert pairs.maps.valid.float().mean((1, 2)).min() > 0.2


def test_rays_meet_what_a_loop_finds(photos):
    rooms, look = random_rooms(3, photos, Draw("cpu", 1), RoomOptions(boxes=6, ellipsoids=5))
    rng = np.random.default_rng(0)
    origins = look.numpy() + rng.uniform(-0.5, 0.5, (3, 3)).astype(np.float32)
    rays = rng.standard_normal((3, 150, 3)).astype(np.float32)
    found, which = first_hits(rooms, torch.from_numpy(origins), torch.from_numpy(rays))

    def first_hit(room: int, ray: np.ndarray) -> tuple[float, int]:
        nearest = math.inf, 0
        for k, (axes, half, centre) in enumerate(
            zip(*(part[room].double().numpy() for part in rooms[:3]), strict=True)
        ):
            start, step = (origins[room] - centre) @ axes / half, ray @ axes / half
            if k >= 7:
                roots = np.roots((step @ step, 2 * start @ step, start @ start - 1))
                hits = [] if np.iscomplex(roots).any() else sorted(roots.real)
            else:
                hits = _cube_parameters(start, step)
            if hits and hits[-1 if k == 0 else 0] > 0.05:
                nearest = min(nearest, (hits[-1 if k == 0 else 0], k))
        return nearest

    expected = [[first_hit(k, ray.astype(float)) for ray in rays[k]] for k in range(3)]
    depth, primitive = (np.array(part) for part in np.moveaxis(np.array(expected), 2, 0))
    same = which.numpy() == primitive
    assert same.mean() > 0.99 and len(np.unique(primitive)) > 8  # a ray may graze an edge
    np.testing.assert_allclose(found.numpy()[same], depth[same], rtol=1e-4)
