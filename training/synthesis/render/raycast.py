"""Cast rays into scenes: images, depth, and the exact map between two views."""

from dataclasses import dataclass

import torch
from torch import Tensor

from dgc_pose.training.synthesis.options import SceneOptions
from dgc_pose.training.synthesis.render.bank import TextureBank
from dgc_pose.training.synthesis.render.cameras import Cameras, relative_pose
from dgc_pose.training.synthesis.render.scene import FACES, Scene, intersect_all

_OCCLUSION_TOLERANCE = 1e-4  # of the distance: another surface this close does not hide a point


@dataclass(frozen=True)
class Hits:
    """The first surface along each of n rays a scene. Without any, depth is infinite and the rest
    arbitrary. Values of surfaces hold the rays of all scenes in one row of B * n."""

    rays: Tensor  # (B, 3, n), in the camera, z = 1
    depth: Tensor  # (B, n), along the optical axis
    primitive: Tensor  # (B, n) int64
    face: Tensor  # (B * n,) int64, counted through the faces of all scenes
    point: Tensor  # (3, B * n), world
    normal: Tensor  # (3, B * n), unit, world, towards the camera
    uv: Tensor  # (2, B * n), world units along the face


def cast(scene: Scene, cameras: Cameras, pixels: Tensor) -> Hits:
    """The first surface seen at pixels (2, n)."""
    rays = cameras.rays(pixels)
    direction = cameras.rotation.mT @ rays
    depth, primitive = intersect_all(scene, cameras.centre, direction).min(dim=1)
    finite = depth.nan_to_num(posinf=1.0)
    point = _row(cameras.centre[..., None] + finite[:, None] * direction)
    direction = _row(direction)

    batch, count = scene.active.shape
    first = torch.arange(batch, device=primitive.device)[:, None] * count
    index = (primitive + first).reshape(-1)
    table = torch.cat(
        (scene.centre, scene.unit_from_world.flatten(2), scene.half_size), dim=-1
    ).flatten(0, 1)
    values = table.t().index_select(1, index)
    to_unit = values[3:12].unflatten(0, (3, 3))
    local = (to_unit * (point - values[:3])).sum(1)
    on_face = local * values[12:15]

    _, quads, _, ellipsoids = scene.layout.spans()
    kind = primitive.reshape(-1)
    is_quad = (kind >= quads.start) & (kind < quads.stop)
    is_ellipsoid = kind >= ellipsoids.start
    axis = _largest_axis(local).masked_fill_(is_quad | is_ellipsoid, 2)
    on_axis = local.gather(0, axis[None])[0]

    along_axis = torch.zeros_like(local).scatter_(0, axis[None], 1.0)
    gradient = torch.where(is_ellipsoid, local, along_axis)
    normal = (to_unit * gradient[:, None]).sum(0)
    away = (normal * direction).sum(0) > 0
    normal = torch.where(away, -normal, normal)
    normal = normal / normal.square().sum(0).sqrt().clamp(min=1e-30)

    positive = torch.where(is_quad, ~away, on_axis > 0)
    u = torch.where(axis == 0, on_face[2], on_face[0])
    v = torch.where(axis == 1, on_face[2], on_face[1])
    stretch = torch.where(is_ellipsoid, _azimuthal_stretch(local), 1.0)
    face = FACES * index + 2 * axis + positive
    return Hits(rays, depth, primitive, face, point, normal, torch.stack((u, v)) * stretch)


def _row(values: Tensor) -> Tensor:
    """(B, 3, n) as (3, B * n)."""
    return values.transpose(0, 1).flatten(1)


def _by_scene(values: Tensor, scenes: int) -> Tensor:
    """(3, B * n) as (B, 3, n)."""
    return values.unflatten(1, (scenes, -1)).transpose(0, 1)


def _largest_axis(local: Tensor) -> Tensor:
    """Index of the largest of three magnitudes; argmax over the first axis is many times slower."""
    x, y, z = local.abs()
    return torch.where(z >= torch.maximum(x, y), 2, (y > x).long())


def _azimuthal_stretch(local: Tensor) -> Tensor:
    """Angle from the z axis over its sine: lays half a ball flat with little distortion."""
    radius = (local[0].square() + local[1].square()).sqrt().clamp(min=1e-6)
    return torch.atan2(radius, local[2].abs()) / radius


def shade(
    scene: Scene, cameras: Cameras, hits: Hits, bank: TextureBank, options: SceneOptions
) -> Tensor:
    """Colours (B, 3, n) in [0, 1] of samples of the pixels; black without a hit."""
    photo = scene.photo.reshape(-1).index_select(0, hits.face)
    a, b, c, d, e, f = scene.texture.reshape(-1, 6).t().index_select(1, hits.face)
    u, v = hits.uv
    direction = _row(cameras.rotation.mT @ hits.rays)
    length = direction.square().sum(0).sqrt()
    cosine = (direction * hits.normal).sum(0).abs() / length
    focal = cameras.K[:, 0, 0].repeat_interleave(hits.depth.shape[1]) * options.supersample
    texels_per_unit = (a * e - b * d).abs().sqrt()
    depth = hits.depth.reshape(-1).nan_to_num(posinf=1.0)
    footprint = texels_per_unit * depth / focal / cosine.clamp(min=0.05).sqrt()
    colour = bank.sample(photo, a * u + b * v + c, d * u + e * v + f, footprint)
    colour = colour * _brightness(scene, hits, options)
    colour = colour.masked_fill(hits.depth.reshape(-1).isinf(), 0.0)
    return _by_scene(colour, len(hits.depth))


def _brightness(scene: Scene, hits: Hits, options: SceneOptions) -> Tensor:
    """Factors (B * n,) in [0, 1] for the colours of the surface."""
    ray = _by_scene(hits.point, len(hits.depth)) - scene.light[..., None]
    away = _row(ray)
    length = away.square().sum(0).sqrt().clamp(min=1e-12)
    cosine = -(hits.normal * away).sum(0) / length
    brightness = 1 - options.shading * (0.5 - 0.5 * cosine)  # wrapped: never black
    if options.shadow > 0:
        shadowed = hidden(scene, scene.light, ray, hits.primitive).reshape(-1) | (cosine <= 0)
        brightness = brightness * (1 - options.shadow * shadowed)
    return brightness


def correspond(scene: Scene, first: Cameras, second: Cameras, hits: Hits) -> tuple[Tensor, Tensor]:
    """The points hit from the second cameras, projected into the first: map (B, 2, n), visible
    (B, n).

    The map is exact for points in front of camera 1, visible or not; for others, and without a hit,
    it is -1. A point is visible if it is inside the frame ([0, w-1] x [0, h-1]), its surface faces
    camera 1 on the same side (every primitive is convex: this excludes occlusion by itself), and no
    other primitive lies on the ray from camera 1 before it.
    """
    pose = relative_pose(second, first)
    depth = hits.depth.nan_to_num(posinf=1.0)[:, None]
    point = pose[..., :3] @ (hits.rays * depth) + pose[..., 3:]
    in_front = (point[:, 2] > 1e-6) & hits.depth.isfinite()
    projected = first.project(point).nan_to_num(-1.0).masked_fill(~in_front[:, None], -1.0)
    width, height = first.size
    inside = in_front & (projected >= 0).all(1) & (projected[:, 0] <= width - 1)
    inside &= projected[:, 1] <= height - 1

    ray = first.rotation.mT @ point
    faces = (_by_scene(hits.normal, len(depth)) * ray).sum(1) < 0
    return projected, inside & faces & ~hidden(scene, first.centre, ray, hits.primitive)


def hidden(scene: Scene, origin: Tensor, direction: Tensor, primitive: Tensor) -> Tensor:
    """(B, n) bool: another primitive lies between origin (B, 3) and origin + direction (B, 3, n).

    primitive: (B, n), which the far end lies on; it is ignored.
    """
    parameters = intersect_all(scene, origin, direction)
    parameters.scatter_(1, primitive[:, None], torch.inf)
    return parameters.amin(1) <= 1 - _OCCLUSION_TOLERANCE
