"""Fixed sets of synthetic pairs from photographs that training holds back.

The paper's sets (section 4 and Table 1) by their published ranges, without photometric changes and
occluders, as its lists have none; and ray-cast 3D scenes.
"""

from collections.abc import Iterator, Sequence
from dataclasses import replace
from itertools import chain
from pathlib import Path

import torch

from dgc_pose.benchmarks.map_run import MapCase, MapSet
from dgc_pose.errors import InputError
from dgc_pose.network.config import INPUT_SIZE
from dgc_pose.training.synthesis.map_pairs import MapPairs
from dgc_pose.training.synthesis.options import (
    WARPS,
    PairOptions,
    PhotometricOptions,
    SceneOptions,
    WarpOptions,
)
from dgc_pose.training.synthesis.photometric import random_photometric
from dgc_pose.training.synthesis.photos import Photos, load_held_back
from dgc_pose.training.synthesis.random_pairs import make_pairs
from dgc_pose.training.synthesis.render.rendered_pairs import render_pairs
from dgc_pose.training.synthesis.warps import FAR

_WARPS = {name: WARPS[f"paper-{name}"] for name in ("affine", "affine-tps", "homography")}
_SCENES = "scenes"  # ray-cast
SETS = (*_WARPS, _SCENES)
SYNTHETIC = (
    "paper, Table 1, affine and affine + thin-plate-spline pairs of its own photographs: "
    "DGC+M-Net aff+tps AEPE 0.82 to 0.96, Jaccard 0.85; DGC-Net AEPE 0.54 to 0.69"
)

# The paper's views are the middle 9/16 of a photograph's width and height, mirrored beyond its
# edges. Ours have any position.
_VIEW = 9 / 16
PHOTO_SIDE = round(INPUT_SIZE / _VIEW / 16) * 16  # pixels: a view is not enlarged once more
ROTATION_DEG = (5.0, 30.0)  # between the cameras of a scene, roll included
_BATCH = 8  # pairs made at a time; another number would make other pairs


def synthetic_set(
    root: str | Path, names: Sequence[str], pairs: int, seed: int, *, changed: bool = False
) -> MapSet:
    """`pairs` pairs of each set named, from the photographs below `root` that training holds back.

    Raises InputError for a name that is none of SETS or for no names, ImageError if no photograph
    is held back.
    """
    for name in names:
        if name not in SETS:
            raise InputError(f"no set '{name}'; there are {', '.join(SETS)}")
    if not names:
        raise InputError("no sets named")
    photos = load_held_back(root, PHOTO_SIDE)
    names = list(dict.fromkeys(names))
    cases = (synthetic_cases(photos, name, pairs, seed, changed=changed) for name in names)
    facts = {"photographs": len(photos.pixels), "seed": seed, "changed": changed}
    all_facts = {**facts, "published": SYNTHETIC}
    return MapSet(chain.from_iterable(cases), pairs * len(names), all_facts)


def synthetic_cases(
    photos: Photos, name: str, pairs: int, seed: int, *, changed: bool = False
) -> Iterator[MapCase]:
    """Batches of the set of that name, always the same for the same photographs and seed.

    changed: with the trainer's photometric changes, and its occluders in warped views.
    """
    generator = torch.Generator().manual_seed(1000 * seed + SETS.index(name))
    if name == _SCENES:
        made = _scenes(photos, generator, changed)
    else:
        made = _warped(photos, _WARPS[name], generator, changed)
    done = 0
    while done < pairs:
        batch = next(made)
        chosen = batch.chosen(slice(min(len(batch.map), pairs - done)))
        # The target may show the plane's horizon, which no real view does.
        horizons = (chosen.map >= FAR).flatten(1).any(1).tolist()
        names = [f"{name} {done + k}" + ", past its horizon" * h for k, h in enumerate(horizons)]
        yield MapCase(name, tuple(names), chosen)
        done += len(names)


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


def _scenes(photos: Photos, generator: torch.Generator, changed: bool) -> Iterator[MapPairs]:
    """Batches of those scenes whose cameras differ by ROTATION_DEG."""
    scenes = SceneOptions(rotation_deg=ROTATION_DEG, supersample=2)
    while True:
        views = render_pairs(photos.textures, _BATCH, INPUT_SIZE, generator, scenes)
        cosine = (views.cam2_from_cam1.diagonal(dim1=1, dim2=2).sum(1) - 1) / 2
        angle = torch.rad2deg(torch.acos(cosine.clamp(-1, 1)))
        kept = (angle >= ROTATION_DEG[0]) & (angle <= ROTATION_DEG[1])
        images = [views.image1, views.image2]
        if changed:
            options = PhotometricOptions()
            images = [random_photometric(image, options, generator) for image in images]
        yield MapPairs(images[0], images[1], views.map, views.visible).chosen(kept)
