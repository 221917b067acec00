"""Batches of pairs of views of random 3D scenes, with their exact geometry."""

from collections.abc import Callable
from dataclasses import dataclass, replace
from operator import itemgetter
from typing import NamedTuple

import numpy as np
import torch
from torch import Tensor

from dgc_pose.training.synthesis.draw import Draw
from dgc_pose.training.synthesis.map_pairs import changed, combined, image_arrays, joined
from dgc_pose.training.synthesis.options import SceneOptions
from dgc_pose.training.synthesis.render.bank import TextureBank
from dgc_pose.training.synthesis.render.cameras import Cameras, relative_pose
from dgc_pose.training.synthesis.render.random_scene import random_camera_pair, random_scene
from dgc_pose.training.synthesis.render.raycast import Hits, cast, correspond, shade
from dgc_pose.training.synthesis.render.scene import Scene

_CHUNK = 16384  # pixels of each view supersampled at a time: they fit a processor's cache
_CPU_PIXELS = 102400  # of all views rendered at a time on a CPU, for the same reason
_PROBE = 20  # overlap is estimated on so many rays squared
_CLEARANCE = 0.05  # between a camera and any object, world units


class Views(NamedTuple):
    """B scenes with two cameras each."""

    scene: Scene
    first: Cameras
    second: Cameras


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


@dataclass(frozen=True)
class RenderedPair:
    """One pair of views as arrays. Pixel (0, 0) is the top-left pixel's centre."""

    image1: np.ndarray  # (h1, w1, 3) uint8, RGB
    image2: np.ndarray  # (h2, w2, 3) uint8, RGB
    K1: np.ndarray  # (3, 3) float64, pixels
    K2: np.ndarray  # (3, 3) float64, pixels
    R: np.ndarray  # (3, 3) float64, x2 = R x1 + t
    t: np.ndarray  # (3,) float64, world units; zero for rotation_only
    map: np.ndarray  # (h2, w2, 2) float64, (x, y) in pixels of image 1; (-1, -1) behind camera 1
    visible: np.ndarray  # (h2, w2) bool, the surface point is seen in image 1
    depth1: np.ndarray  # (h1, w1) float64, along the optical axis, world units
    depth2: np.ndarray  # (h2, w2) float64


def render_pairs(
    bank: TextureBank,
    batch: int,
    size: int,
    generator: torch.Generator,
    options: SceneOptions,
) -> RenderedPairs:
    """Two views, `size` pixels square, of each of `batch` random scenes with textures of `bank`.

    All random numbers come from `generator`: the scenes do not depend on the bank's device. All
    values are float32.
    """
    draw = Draw(generator, bank.texels.device)

    def draw_views() -> Views:
        first, second = random_camera_pair(draw, batch, size, options)
        scene = random_scene(draw, first, second, bank.size, bank.count, options)
        return Views(scene, first, second)

    views = overlapping(draw_views, options)
    light2 = views.scene.light + options.light_change * draw.normal(batch, 3)
    return render_views(views, bank, options, light2)


def overlapping(draw_views: Callable[[], Views], options: SceneOptions) -> Views:
    """B pairs, each with enough overlap, or else the best of the options' tries."""
    best = draw_views()
    best_share = _overlap(best)
    for _ in range(options.tries - 1):
        if bool((best_share >= options.min_overlap).all()):
            break
        other = draw_views()
        share = _overlap(other)
        keep = (best_share >= options.min_overlap) | (best_share >= share)

        def better(pair: list[Tensor], keep: Tensor = keep) -> Tensor:
            return torch.where(keep.view((-1,) + (1,) * (pair[0].ndim - 1)), pair[0], pair[1])

        best = Views._make(combined(pair, better) for pair in zip(best, other, strict=True))
        best_share = torch.where(keep, best_share, share)
    return best


def _overlap(views: Views) -> Tensor:
    """Share (B,) of a coarse grid of image 2's pixels that are visible in image 1.

    -1 if a camera is in an object or too near to it.
    """
    scene, first, second = views
    grid = (torch.arange(_PROBE, dtype=second.K.dtype, device=second.K.device) + 0.5) / _PROBE
    width, height = second.size
    x, y = grid.repeat(_PROBE) * width - 0.5, grid.repeat_interleave(_PROBE) * height - 0.5
    _, visible = correspond(scene, first, second, cast(scene, second, torch.stack((x, y))))
    blocked = scene.contains(first.centre, _CLEARANCE) | scene.contains(second.centre, _CLEARANCE)
    return visible.to(grid.dtype).mean(1).masked_fill(blocked, -1.0)


def render_views(
    views: Views, bank: TextureBank, options: SceneOptions, light2: Tensor
) -> RenderedPairs:
    """Both views of scenes; light2: positions (B, 3) of the light in the second view."""
    scene, first, second = views
    width, height = second.size
    together = max(1, _CPU_PIXELS // (width * height))
    if len(second.K) > together and second.K.device.type == "cpu":
        parts = []
        for k in range(0, len(second.K), together):
            span = slice(k, k + together)
            part = Views._make(changed(batch, itemgetter(span)) for batch in views)
            parts.append(render_views(part, bank, options, light2[span]))
        return joined(parts)
    hits1, hits2 = (cast(scene, cameras, cameras.pixels()) for cameras in (first, second))
    image1 = _image(scene, first, hits1, bank, options)
    image2 = _image(replace(scene, light=light2), second, hits2, bank, options)
    projected, visible = correspond(scene, first, second, hits2)
    return RenderedPairs(
        image1=_as_grid(image1, first),
        image2=_as_grid(image2, second),
        map=_as_grid(projected, second).permute(0, 2, 3, 1).contiguous(),
        visible=_as_grid(visible, second),
        depth1=_as_grid(hits1.depth, first),
        depth2=_as_grid(hits2.depth, second),
        K1=first.K,
        K2=second.K,
        cam2_from_cam1=relative_pose(first, second),
    )


def as_arrays(pairs: RenderedPairs) -> RenderedPair:
    """The first pair of a batch, as numpy arrays and 8-bit images."""
    names = ("K1", "K2", "map", "depth1", "depth2")
    values = {name: getattr(pairs, name)[0].double().numpy() for name in names}
    for name in ("image1", "image2"):
        values[name] = image_arrays(getattr(pairs, name)[:1])[0]
    pose = pairs.cam2_from_cam1[0].double().numpy()
    return RenderedPair(R=pose[:, :3], t=pose[:, 3], visible=pairs.visible[0].numpy(), **values)


def _image(
    scene: Scene, cameras: Cameras, hits: Hits, bank: TextureBank, options: SceneOptions
) -> Tensor:
    """Colours (B, 3, n): of the pixel centres, or the mean over a grid of samples in each pixel."""
    samples = options.supersample
    if samples == 1:
        return shade(scene, cameras, hits, bank, options)
    offsets = [(k + 0.5) / samples - 0.5 for k in range(samples)]
    total = torch.zeros_like(hits.rays)
    for moved in (cameras.shifted(x, y) for x in offsets for y in offsets):
        chunks = moved.pixels().split(_CHUNK, dim=1)
        colours = [shade(scene, moved, cast(scene, moved, p), bank, options) for p in chunks]
        total += torch.cat(colours, dim=-1)
    return total / samples**2


def _as_grid(values: Tensor, cameras: Cameras) -> Tensor:
    width, height = cameras.size
    return values.unflatten(-1, (height, width))
