"""Batches of scenes of textured primitives, and their intersection with rays."""

from __future__ import annotations

from dataclasses import dataclass
from itertools import accumulate
from typing import NamedTuple

import torch
from torch import Tensor

from dgc_pose.synthesis.render.primitives import (
    intersect_box,
    intersect_ellipsoid,
    intersect_quad,
    intersect_room,
)

FACES = 6  # -x +x -y +y -z +z of a box or room; -z and +z of a quad's sides, an ellipsoid's halves
_INTERSECT = (intersect_room, intersect_quad, intersect_box, intersect_ellipsoid)


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
    for span, intersect in zip(scene.layout.spans(), _INTERSECT, strict=True):
        local = (to_unit[:, span].flatten(1, 2) @ direction).unflatten(1, (-1, 3))
        hits[:, span] = intersect(start[:, span], local)
    return hits.masked_fill_(~scene.active[..., None], torch.inf)
