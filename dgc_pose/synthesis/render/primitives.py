"""Rays against the four unit primitives, each in its own frame.

A scene maps every primitive to a unit shape (the cube or the ball of half size 1, or the square of
half size 1 in the plane z = 0), which leaves the ray parameter unchanged. All functions take the
ray origin (..., 3, 1) and directions (..., 3, n) in that frame, and return the parameter (..., n)
of the first surface in front of the origin, infinity without any.
"""

from __future__ import annotations

import math

import torch
from torch import Tensor

_TINY = 1e-30  # added to directions, so that a component of exactly zero gives no 0 * inf


def intersect_room(origin: Tensor, direction: Tensor) -> Tensor:
    """The cube seen from inside: the exit of a ray, infinity if it misses."""
    near, far = _slabs(origin, direction)
    return far.masked_fill((near > far) | (far <= 0), math.inf)


def intersect_box(origin: Tensor, direction: Tensor) -> Tensor:
    """The cube seen from outside: the entry of a ray; infinity from inside."""
    near, far = _slabs(origin, direction)
    return near.masked_fill((near > far) | (near <= 0), math.inf)


def intersect_ellipsoid(origin: Tensor, direction: Tensor) -> Tensor:
    """The unit ball seen from outside.

    The discriminant is written with the cross product, |d|^2 - |o x d|^2, because b^2 - a c loses
    half the digits of float32 for a small ball far away.
    """
    ox, oy, oz = origin.unbind(-2)
    dx, dy, dz = direction.unbind(-2)
    square = dx * dx + dy * dy + dz * dz
    cross = (oy * dz - oz * dy).square()
    cross += (oz * dx - ox * dz).square()
    cross += (ox * dy - oy * dx).square()
    discriminant = square - cross
    along = ox * dx + oy * dy + oz * dz
    first = -(along + discriminant.clamp(min=0).sqrt()) / square
    return first.masked_fill((discriminant < 0) | (first <= 0), math.inf)


def intersect_quad(origin: Tensor, direction: Tensor) -> Tensor:
    """The square in z = 0, seen from both sides."""
    ox, oy, oz = origin.unbind(-2)
    dx, dy, dz = direction.unbind(-2)
    hit = -oz / (dz + _TINY)
    outside = torch.maximum((ox + hit * dx).abs(), (oy + hit * dy).abs()) > 1
    return hit.masked_fill(outside | (hit <= 0), math.inf)


def _slabs(origin: Tensor, direction: Tensor) -> tuple[Tensor, Tensor]:
    """Parameters at which the rays' lines enter and leave the cube; near > far if they miss."""
    inverse = (direction + _TINY).reciprocal_()
    middle = -origin * inverse
    half = inverse.abs_()
    near_x, near_y, near_z = (middle - half).unbind(-2)
    far_x, far_y, far_z = middle.add_(half).unbind(-2)
    near = torch.maximum(torch.maximum(near_x, near_y), near_z)
    far = torch.minimum(torch.minimum(far_x, far_y), far_z)
    return near, far
