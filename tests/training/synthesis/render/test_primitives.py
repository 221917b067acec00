"""Ray intersections against loops over rays in float64, written another way."""

import math

import numpy as np
import pytest
import torch

from dgc_pose.training.synthesis.render.scene import (
    intersect_box,
    intersect_ellipsoid,
    intersect_quad,
    intersect_room,
)

RAYS = 2000


def plane_hits(origin: np.ndarray, direction: np.ndarray) -> list[float]:
    """Parameters at which a line meets the surface of the unit cube, by its six planes."""
    result = []
    for axis in range(3):
        for side in (-1.0, 1.0):
            if direction[axis] == 0:
                continue
            t = (side - origin[axis]) / direction[axis]
            point = origin + t * direction
            if all(abs(point[k]) <= 1 for k in range(3) if k != axis):
                result.append(t)
    return result


def box_by_loop(origin: np.ndarray, direction: np.ndarray) -> float:
    if np.abs(origin).max() < 1:
        return math.inf
    return min((t for t in plane_hits(origin, direction) if t > 0), default=math.inf)


def room_by_loop(origin: np.ndarray, direction: np.ndarray) -> float:
    return max((t for t in plane_hits(origin, direction) if t > 0), default=math.inf)


def ellipsoid_by_loop(origin: np.ndarray, direction: np.ndarray) -> float:
    roots = np.roots((direction @ direction, 2 * origin @ direction, origin @ origin - 1))
    if np.iscomplex(roots).any():
        return math.inf
    first = roots.real.min()
    return first if first > 0 else math.inf


def quad_by_loop(origin: np.ndarray, direction: np.ndarray) -> float:
    t = -origin[2] / direction[2]
    point = origin + t * direction
    return t if t > 0 and np.abs(point[:2]).max() <= 1 else math.inf


CASES = (
    (intersect_box, box_by_loop),
    (intersect_room, room_by_loop),
    (intersect_ellipsoid, ellipsoid_by_loop),
    (intersect_quad, quad_by_loop),
)


@pytest.mark.parametrize(("function", "loop"), CASES)
@pytest.mark.parametrize("distance", (1.3, 3.0, 40.0))  # 1.3: some origins are in the cube
@pytest.mark.parametrize("dtype", (torch.float32, torch.float64))
def test_intersections_agree_with_a_loop(function, loop, distance, dtype):
    rng = np.random.default_rng(int(10 * distance))
    origins = rng.standard_normal((RAYS, 3))
    origins *= distance / np.linalg.norm(origins, axis=1, keepdims=True)
    targets = rng.uniform(-1.3, 1.3, (RAYS, 3))
    directions = (targets - origins) * rng.uniform(0.2, 2.0, (RAYS, 1))
    origins, directions = np.float32(origins), np.float32(directions)  # the same for both types

    expected = np.array(
        [loop(np.float64(o), np.float64(d)) for o, d in zip(origins, directions, strict=True)]
    )
    result = function(
        torch.from_numpy(origins).to(dtype)[..., None],
        torch.from_numpy(directions).to(dtype)[..., None],
    )[:, 0].numpy()

    hit, expected_hit = np.isfinite(result), np.isfinite(expected)
    assert 0.05 * RAYS < expected_hit.sum()
    # A ray that grazes an edge may fall on either side of it in float32.
    allowed = 0 if dtype == torch.float64 else 2
    assert (hit != expected_hit).sum() <= allowed
    both = hit & expected_hit
    error = np.abs(result[both] - expected[both]) / np.maximum(1, expected[both])
    assert error.max() < (1e-12 if dtype == torch.float64 else 3e-4)
    assert np.median(error) < (1e-14 if dtype == torch.float64 else 3e-7)


def test_rays_along_an_axis_meet_the_cube():
    """Direction components of exactly zero, at the middle and on the face plane."""
    origin = torch.tensor([[0.0, 0.0, -3.0], [0.0, 1.0, -3.0], [0.0, 2.0, -3.0]])[..., None]
    direction = torch.tensor([[0.0, 0.0, 2.0]] * 3)[..., None]
    assert intersect_box(origin, direction)[:, 0].tolist()[::2] == [1.0, math.inf]
    assert not intersect_box(origin, direction).isnan().any()
    assert intersect_room(origin, direction)[0, 0] == 2.0


@pytest.mark.parametrize("function", (intersect_box, intersect_ellipsoid, intersect_quad))
def test_nothing_is_met_behind_the_origin(function):
    origin = torch.tensor([[0.1], [0.2], [4.0]])
    ahead, behind = torch.tensor([[0.0], [0.0], [-1.0]]), torch.tensor([[0.0], [0.0], [1.0]])
    assert torch.isfinite(function(origin, ahead)).all()
    assert torch.isinf(function(origin, behind)).all()
