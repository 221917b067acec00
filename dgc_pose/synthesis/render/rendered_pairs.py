"""Batches of pairs of views of random 3D scenes, with their exact geometry."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from functools import partial

import torch
from torch import Tensor

from dgc_pose.synthesis.batches import joined
from dgc_pose.synthesis.draw import Draw
from dgc_pose.synthesis.options import SceneOptions
from dgc_pose.synthesis.render.bank import TextureBank
from dgc_pose.synthesis.render.cameras import Cameras, relative_pose
from dgc_pose.synthesis.render.overlap import Candidate, overlapping
from dgc_pose.synthesis.render.random_cameras import random_camera_pair
from dgc_pose.synthesis.render.random_scene import random_scene
from dgc_pose.synthesis.render.raycast import Hits, Surface, cast, correspond, describe, shade
from dgc_pose.synthesis.render.scene import Scene, part

_CHUNK = 16384  # pixels of each view supersampled at a time: they fit a processor's cache
_CPU_PIXELS = 102400  # of all views rendered at a time on a CPU, for the same reason


@dataclass(frozen=True)
class RenderedPairs:
    """B pairs of views. Images are RGB in [0, 1]; pixel (0, 0) is the top-left pixel's centre."""

    image1: Tensor  # (B, 3, h1, w1) float
    image2: Tensor  # (B, 3, h2, w2) float
    map: Tensor  # (B, h2, w2, 2) float, (x, y) in pixels of image 1; (-1, -1) behind camera 1
    visible: Tensor  # (B, h2, w2) bool, the surface point is seen in image 1
    depth1: Tensor  # (B, h1, w1) float, along the optical axis, world units, inf: nothing
    depth2: Tensor  # (B, h2, w2) float
    K1: Tensor  # (B, 3, 3) float, pixels
    K2: Tensor  # (B, 3, 3) float, pixels
    cam2_from_cam1: Tensor  # (B, 3, 4) float, x2 = R x1 + t, world units


def render_pairs(
    bank: TextureBank, batch: int, size: int, generator: torch.Generator, options: SceneOptions
) -> RenderedPairs:
    """Two views, `size` pixels square, of each of `batch` random scenes with textures of `bank`.

    All random numbers come from `generator`: the scenes do not depend on the bank's device. All
    values are float32.
    """
    draw = Draw(generator, bank.texels.device)

    def draw_candidate() -> Candidate:
        first, second = random_camera_pair(draw, batch, size, options)
        scene = random_scene(draw, first, second, bank.size, bank.count, options)
        return Candidate(scene, first, second)

    views = overlapping(draw_candidate, min_overlap=options.min_overlap, tries=options.tries)
    light = views.scene.light
    lights = (light, light + options.light_change * draw.normal(batch, 3))
    return render_views(views, bank, lights, options, options.supersample)


def render_views(
    views: Candidate,
    bank: TextureBank,
    lights: tuple[Tensor, Tensor],
    options: SceneOptions,
    supersample: int,
) -> RenderedPairs:
    """Both views of scenes; `lights` are the positions (B, 3) of the light in each view."""
    scene, first, second = views
    width, height = second.size
    together = max(1, _CPU_PIXELS // (width * height))
    if len(second.K) > together and second.K.device.type == "cpu":
        parts = []
        for k in range(0, len(second.K), together):
            span = slice(k, k + together)
            chunk = Candidate(part(scene, span), part(first, span), part(second, span))
            light1, light2 = (light[span] for light in lights)
            parts.append(render_views(chunk, bank, (light1, light2), options, supersample))
        return joined(parts)
    images, depths, seen = [], [], []
    for cameras, light in zip((first, second), lights, strict=True):
        hits = cast(scene, cameras, cameras.pixels())
        surface = describe(scene, cameras, hits)
        coloured = partial(shade, bank=bank, light=light, options=options)
        image = _image(scene, cameras, hits, surface, coloured, supersample)
        images.append(_as_grid(image, cameras))
        depths.append(_as_grid(hits.depth, cameras))
        seen.append((hits, surface))
    projected, visible = correspond(scene, first, second, *seen[1])
    return RenderedPairs(
        image1=images[0],
        image2=images[1],
        map=_as_grid(projected, second).permute(0, 2, 3, 1).contiguous(),
        visible=_as_grid(visible, second),
        depth1=depths[0],
        depth2=depths[1],
        K1=first.K,
        K2=second.K,
        cam2_from_cam1=relative_pose(first, second),
    )


def _image(
    scene: Scene,
    cameras: Cameras,
    hits: Hits,
    surface: Surface,
    coloured: Callable[..., Tensor],
    supersample: int,
) -> Tensor:
    """Colours (B, 3, n): of the pixel centres, or the mean over a grid of samples in each pixel."""
    if supersample == 1:
        return coloured(scene, cameras, hits, surface)
    offsets = [(k + 0.5) / supersample - 0.5 for k in range(supersample)]
    total = torch.zeros_like(hits.rays)
    for moved in (cameras.shifted(x, y) for x in offsets for y in offsets):
        colours = []
        for pixels in moved.pixels().split(_CHUNK, dim=1):
            hits = cast(scene, moved, pixels)
            surface = describe(scene, moved, hits)
            colours.append(coloured(scene, moved, hits, surface, samples=supersample))
        total += torch.cat(colours, dim=-1)
    return total / supersample**2


def _as_grid(values: Tensor, cameras: Cameras) -> Tensor:
    width, height = cameras.size
    return values.unflatten(-1, (height, width))
