"""Batches of pairs of views of random 3D scenes, with their exact geometry."""

from __future__ import annotations

from dataclasses import dataclass
from functools import partial

import torch
from torch import Tensor

from dgc_pose.errors import InputError
from dgc_pose.synthesis.batches import joined
from dgc_pose.synthesis.draw import Draw
from dgc_pose.synthesis.options import SceneOptions
from dgc_pose.synthesis.render.bank import TextureBank
from dgc_pose.synthesis.render.cameras import Cameras, relative_pose
from dgc_pose.synthesis.render.overlap import Candidate, overlapping
from dgc_pose.synthesis.render.random_cameras import random_camera_pair
from dgc_pose.synthesis.render.random_scene import random_scene
from dgc_pose.synthesis.render.raycast import (
    Hits,
    Lighting,
    Surface,
    cast,
    correspond,
    describe,
    shade,
)
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
    values are float32. Raises InputError for a batch below 1 or a size below 2.
    """
    if batch < 1 or size < 2:
        raise InputError(f"batch and size must be at least 1 and 2, not {batch} and {size}")
    draw = Draw(generator, bank.texels.device)

    def draw_candidate() -> Candidate:
        first, second = random_camera_pair(draw, batch, size, options)
        scene = random_scene(draw, first, second, bank.size, bank.count, options)
        return Candidate(scene, first, second)

    scene, first, second = overlapping(
        draw_candidate, min_overlap=options.min_overlap, tries=options.tries
    )
    lights = (scene.light, scene.light + options.light_change * draw.normal(batch, 3))
    return render_views(
        scene,
        first,
        second,
        bank,
        lights=lights,
        lighting=Lighting(options.shading, options.shadow),
        supersample=options.supersample,
    )


def render_views(
    scene: Scene,
    first: Cameras,
    second: Cameras,
    bank: TextureBank,
    *,
    lights: tuple[Tensor, Tensor],
    lighting: Lighting,
    supersample: int = 1,
) -> RenderedPairs:
    """Both views of given scenes; `lights` are the positions (B, 3) of the light in each view."""
    width, height = second.size
    together = max(1, _CPU_PIXELS // (width * height))
    if len(second.K) > together and second.K.device.type == "cpu":
        spans = [slice(k, k + together) for k in range(0, len(second.K), together)]
        parts = [
            render_views(
                part(scene, span),
                part(first, span),
                part(second, span),
                bank,
                lights=(lights[0][span], lights[1][span]),
                lighting=lighting,
                supersample=supersample,
            )
            for span in spans
        ]
        return joined(parts)
    images, depths, seen = [], [], []
    for cameras, light in zip((first, second), lights, strict=True):
        hits = cast(scene, cameras, cameras.pixels())
        surface = describe(scene, cameras, hits)
        image = _image(scene, cameras, hits, surface, bank, light, lighting, supersample)
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
    bank: TextureBank,
    light: Tensor,
    lighting: Lighting,
    supersample: int,
) -> Tensor:
    """Colours (B, 3, n): of the pixel centres, or the mean over a grid of samples in each pixel."""
    coloured = partial(shade, bank=bank, light=light, lighting=lighting)
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
