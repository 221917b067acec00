"""Fixed sets of synthetic pairs from photographs that trained nothing.

The paper's sets (its section 4 and Table 1) by their published ranges, without photometric change
and without anything standing before the views, as its lists have none; and ray-cast 3D scenes.
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import replace
from pathlib import Path

import torch
from torch import Tensor

from dgc_pose.benchmarks.map_run import Case
from dgc_pose.errors import InputError
from dgc_pose.network.config import INPUT_SIZE
from dgc_pose.synthesis.map_pairs import MapPairs
from dgc_pose.synthesis.photometric import PhotometricOptions, random_photometric
from dgc_pose.synthesis.photos import Photos
from dgc_pose.synthesis.random_pairs import PairOptions, make_pairs
from dgc_pose.synthesis.render import SceneOptions, render_pairs
from dgc_pose.synthesis.warp_lists import WarpRow, list_pairs
from dgc_pose.synthesis.warps import (
    FAR,
    PAPER_AFFINE,
    PAPER_AFFINE_TPS,
    PAPER_HOMOGRAPHY,
    WarpOptions,
)

# By name, the paper's ranges; the scenes beside them are ray-cast.
_WARPS: dict[str, WarpOptions] = {
    "affine": PAPER_AFFINE,
    "affine-tps": PAPER_AFFINE_TPS,
    "homography": PAPER_HOMOGRAPHY,
}
_SCENES = "scenes"
SETS = (*_WARPS, _SCENES)

# The paper's views are the middle 9/16 of a photograph's width and height, mirrored beyond its
# edges. Ours lie anywhere in it.
_VIEW = 9 / 16
PHOTO_SIDE = round(INPUT_SIZE / _VIEW / 16) * 16  # pixels, so that a view is not enlarged again
ROTATION_DEG = (5.0, 30.0)  # between the cameras of a scene, roll and all
_BATCH = 8  # pairs made at a time; another number would make other pairs


def synthetic_cases(
    photos: Photos, name: str, pairs: int, seed: int, *, changed: bool = False
) -> Iterator[Case]:
    """Batches of the set of that name, always the same for the same photographs and seed.

    changed: with the trainer's photometric changes, and its occluders before warped views.
    Raises InputError for a name that is none of SETS.
    """
    if name not in SETS:
        raise InputError(f"no set '{name}'; there are {', '.join(SETS)}")
    generator = torch.Generator().manual_seed(1000 * seed + SETS.index(name))
    if name == _SCENES:
        made = _scenes(photos, generator, changed)
    else:
        made = _warped(photos, _WARPS[name], generator, changed)
    done = 0
    while done < pairs:
        batch = next(made)
        kept = min(len(batch.map), pairs - done)
        names = tuple(
            f"{name} {done + index}" + ", past its horizon" * beyond
            for index, beyond in enumerate(_see_past_the_horizon(batch)[:kept])
        )
        yield Case(name, names, batch.chosen(slice(kept)))
        done += kept


def _see_past_the_horizon(pairs: MapPairs) -> list[bool]:
    """Of which pairs the target shows more than the plane: no camera sees it turned so far."""
    return (pairs.map >= FAR).flatten(1).any(1).tolist()


def listed_cases(rows: Sequence[WarpRow], root: str | Path) -> Iterator[Case]:
    """Batches of the pairs of an authors' list, by kind, of photographs below `root`.

    Raises ImageError where a photograph cannot be read.
    """
    for kind in dict.fromkeys(row.kind for row in rows):
        numbered = [(n, row) for n, row in enumerate(rows, start=1) if row.kind == kind]
        for start in range(0, len(numbered), _BATCH):
            part = numbered[start : start + _BATCH]
            names = tuple(f"{row.file}, row {n}" for n, row in part)
            yield Case(kind, names, list_pairs([row for _, row in part], root))


def _warped(
    photos: Photos, warps: WarpOptions, generator: torch.Generator, changed: bool
) -> Iterator[MapPairs]:
    options = PairOptions(
        scene_share=0.0, warps=warps, view_scale=(_VIEW, _VIEW), view_roll_deg=0.0
    )
    if not changed:
        options = replace(options, photometric=None, occluder_share=0.0)
    while True:
        yield make_pairs(photos, _BATCH, INPUT_SIZE, generator, options)


def _scenes(
    photos: Photos, generator: torch.Generator, changed: bool
) -> Iterator[MapPairs]:
    """Batches of those scenes whose cameras differ by ROTATION_DEG."""
    scenes = SceneOptions(rotation_deg=ROTATION_DEG, supersample=2)
    while True:
        views = render_pairs(photos.textures, _BATCH, INPUT_SIZE, generator, scenes)
        angle = _rotation_deg(views.cam2_from_cam1[:, :, :3])
        kept = (angle >= ROTATION_DEG[0]) & (angle <= ROTATION_DEG[1])
        images = [views.image1, views.image2]
        if changed:
            options = PhotometricOptions()
            images = [random_photometric(image, options, generator) for image in images]
        yield MapPairs(images[0], images[1], views.map, views.visible).chosen(kept)


def _rotation_deg(R: Tensor) -> Tensor:
    """Angles (B,) of rotations (B, 3, 3), degrees."""
    cosine = (R.diagonal(dim1=1, dim2=2).sum(1) - 1) / 2
    return torch.rad2deg(torch.acos(cosine.clamp(-1, 1)))
