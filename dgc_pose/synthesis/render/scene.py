"""Batches of scenes of textured primitives, and their intersection with rays."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Literal, NamedTuple

import torch
from torch import Tensor

from dgc_pose.synthesis.batches import Batch, changed, combined
from dgc_pose.synthesis.render.primitives import (
    intersect_box,
    intersect_ellipsoid,
    intersect_quad,
    intersect_room,
)

Kind = Literal["room", "quad", "box", "ellipsoid"]
KINDS: tuple[Kind, ...] = ("room", "quad", "box", "ellipsoid")
FACES = 6  # -x +x -y +y -z +z of a box or room; -z and +z of a quad's sides, an ellipsoid's halves

_INTERSECT = {
    "room": intersect_room,
    "quad": intersect_quad,
    "box": intersect_box,
    "ellipsoid": intersect_ellipsoid,
}


class Layout(NamedTuple):
    """How many primitives of each kind a scene has; they are stored in this order."""

    room: int
    quad: int
    box: int
    ellipsoid: int

    def span(self, kind: Kind) -> slice:
        start = sum(self[: KINDS.index(kind)])
        return slice(start, start + getattr(self, kind))


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
        size[:, self.layout.span("quad"), 2] = 1
        return self.axes / size[..., None]

    def contains(self, point: Tensor, margin: float) -> Tensor:
        """(B,) bool: the points (B, 3) lie in a box or ellipsoid grown by `margin` world units."""
        offset = (self.axes @ (point[:, None] - self.centre)[..., None])[..., 0]
        local = offset.abs() / (self.half_size + margin)
        inside = torch.zeros_like(self.active)
        boxes, ellipsoids = self.layout.span("box"), self.layout.span("ellipsoid")
        inside[:, boxes] = local[:, boxes].amax(-1) < 1
        inside[:, ellipsoids] = local[:, ellipsoids].square().sum(-1) < 1
        return (inside & self.active).any(-1)


def select(mask: Tensor, first: Batch, second: Batch) -> Batch:
    """Two batches merged: rows of the first if mask (B,) is True, else of the second."""

    def merged(pair: list[Tensor]) -> Tensor:
        return torch.where(mask.view((-1,) + (1,) * (pair[0].ndim - 1)), pair[0], pair[1])

    return combined([first, second], merged)


def part(batch: Batch, span: slice) -> Batch:
    """Some of a batch's scenes or cameras."""
    return changed(batch, lambda values: values[span])


def intersect_all(scene: Scene, origin: Tensor, direction: Tensor) -> Tensor:
    """Ray parameters of every primitive's first hit: (B, P, n), infinity without any.

    `origin` (B, 3) and `direction` (B, 3, n) are in the world; directions need no unit length.
    """
    batch, _, rays = direction.shape
    to_unit = scene.unit_from_world
    start = to_unit @ (origin[:, None] - scene.centre)[..., None]
    hits = direction.new_empty(batch, sum(scene.layout), rays)
    for kind in KINDS:
        span = scene.layout.span(kind)
        count = span.stop - span.start
        if count == 0:
            continue
        local = (to_unit[:, span].flatten(1, 2) @ direction).unflatten(1, (count, 3))
        hits[:, span] = _INTERSECT[kind](start[:, span], local)
    return hits.masked_fill_(~scene.active[..., None], torch.inf)
