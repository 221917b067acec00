"""Random scenes and cameras, drawn until the two views overlap."""

from __future__ import annotations

from collections.abc import Callable
from typing import NamedTuple

import torch
from torch import Tensor

from dgc_pose.synthesis.render.cameras import Cameras
from dgc_pose.synthesis.render.raycast import cast, correspond, describe
from dgc_pose.synthesis.render.scene import Scene, select

_PROBE = 20  # overlap is estimated on so many rays squared
_CLEARANCE = 0.05  # between a camera and any object, world units


class Candidate(NamedTuple):
    """B scenes with two cameras each."""

    scene: Scene
    first: Cameras
    second: Cameras


def overlapping(
    draw_candidate: Callable[[], Candidate], *, min_overlap: float, tries: int
) -> Candidate:
    """B pairs, each with enough overlap, or else the best of `tries` draws."""
    best = draw_candidate()
    best_share = overlap(*best)
    for _ in range(tries - 1):
        if bool((best_share >= min_overlap).all()):
            break
        other = draw_candidate()
        share = overlap(*other)
        keep = (best_share >= min_overlap) | (best_share >= share)
        best = Candidate(
            select(keep, best.scene, other.scene),
            select(keep, best.first, other.first),
            select(keep, best.second, other.second),
        )
        best_share = torch.where(keep, best_share, share)
    return best


def overlap(scene: Scene, first: Cameras, second: Cameras) -> Tensor:
    """Share (B,) of a coarse grid of image 2's pixels that are visible in image 1.

    -1 if a camera is in an object or too near to it.
    """
    grid = (torch.arange(_PROBE, dtype=second.K.dtype, device=second.K.device) + 0.5) / _PROBE
    width, height = second.size
    x, y = grid.repeat(_PROBE) * width - 0.5, grid.repeat_interleave(_PROBE) * height - 0.5
    hits = cast(scene, second, torch.stack((x, y)))
    _, visible = correspond(scene, first, second, hits, describe(scene, second, hits))
    blocked = scene.contains(first.centre, _CLEARANCE) | scene.contains(second.centre, _CLEARANCE)
    return visible.to(grid.dtype).mean(1).masked_fill(blocked, -1.0)
