"""Batches of scenes of textured primitives, and their intersection with rays."""

import math
from dataclasses import dataclass
from itertools import accumulate
from typing import NamedTuple

import torch
from torch import Tensor

FACES = 6  # -x +x -y +y -z +z of a box or room; -z and +z of a quad's sides, an ellipsoid's halves
_TINY = 1e-30  # added to directions, so that a component of exactly zero gives no 0 * inf


class Layout(NamedTuple):
    """How many primitives of each kind a scene has; they are stored in this order."""

    room: int
    quad: int
    box: int
    ellipsoid: int

    def spans(self) -> list[slice]:
        """The primitives of each kind."""
        stops = accumulate(self)
        return [slice(stop - count, stop) for count, stop in zip(self, stops, strict=True)]


@dataclass(frozen=True)
class Scene:
    """B scenes of P primitives each. World y points down; a room is a box seen from inside."""

    layout: Layout
    centre: Tensor  # (B, P, 3), world units
    axes: Tensor  # (B, P, 3, 3), rows are the primitive's axes in the world
    half_size: Tensor  # (B, P, 3), world units, along those axes; a quad's third is not used
    active: Tensor  # (B, P) bool, False: the primitive is absent
    photo: Tensor  # (B, P, 6) int64, the texture of each face
    texture: Tensor  # (B, P, 6, 2, 3), texels of the photo from units along the face, affine
    light: Tensor  # (B, 3), a point light, world units

    @property
    def unit_from_world(self) -> Tensor:
        """(B, P, 3, 3): world directions to the frame in which the primitive is a unit shape."""
        size = self.half_size.clone()
        size[:, self.layout.spans()[1], 2] = 1
        return self.axes / size[..., None]

    def contains(self, point: Tensor, margin: float) -> Tensor:
        """(B,) bool: the points (B, 3) lie in a box or ellipsoid grown by `margin` world units."""
        offset = (self.axes @ (point[:, None] - self.centre)[..., None])[..., 0]
        local = offset.abs() / (self.half_size + margin)
        inside = torch.zeros_like(self.active)
        _, _, boxes, ellipsoids = self.layout.spans()
        inside[:, boxes] = local[:, boxes].amax(-1) < 1
        inside[:, ellipsoids] = local[:, ellipsoids].square().sum(-1) < 1
        return (inside & self.active).any(-1)


def intersect_all(scene: Scene, origin: Tensor, direction: Tensor) -> Tensor:
    """Ray parameters of every primitive's first hit: (B, P, n), infinity without any.

    `origin` (B, 3) and `direction` (B, 3, n) are in the world; directions need no unit length.
    """
    batch, _, rays = direction.shape
    to_unit = scene.unit_from_world
    start = to_unit @ (origin[:, None] - scene.centre)[..., None]
    hits = direction.new_empty(batch, sum(scene.layout), rays)
    intersections = (intersect_room, intersect_quad, intersect_box, intersect_ellipsoid)
    for span, intersect in zip(scene.layout.spans(), intersections, strict=True):
        local = (to_unit[:, span].flatten(1, 2) @ direction).unflatten(1, (-1, 3))
        hits[:, span] = intersect(start[:, span], local)
    return hits.masked_fill_(~scene.active[..., None], torch.inf)


# Rays against the four unit primitives, each in its own frame: the cube or the ball of half size 1,
# or the square of half size 1 in the plane z = 0. The maps to these leave the ray parameter as it
# is. All take the ray origin (..., 3, 1) and directions (..., 3, n), and return the parameter
# (..., n) of the first surface in front of the origin, infinity without any.


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
