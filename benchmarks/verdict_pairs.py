"""Pairs that the verdict is measured on: unrelated images, true pairs, and ones that mislead.

What a user named is checked when a function is called; images are read pair by pair.
"""

from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass, replace
from itertools import chain, islice
from pathlib import Path
from typing import Literal, get_args

import numpy as np

from dgc_pose.benchmarks.posed_pairs import (
    Ids,
    ListedPairs,
    PairSet,
    PosedPair,
    RenderedPosedPairs,
    Truth,
    require_images,
    unrelated_pair,
)
from dgc_pose.benchmarks.verdicts import PairKind, VerdictScore
from dgc_pose.cameras.camera import Camera
from dgc_pose.cameras.pair_list import read_pairs
from dgc_pose.errors import InputError
from dgc_pose.images.folder import search_images
from dgc_pose.images.image import Image
from dgc_pose.training.synthesis.misleading import (
    middle_quarter,
    night,
    render_facade,
    rolled,
    with_moving_object,
)
from dgc_pose.training.synthesis.photos import held_back_paths
from dgc_pose.training.synthesis.render.scene_pair import PairKind as SceneKind
from dgc_pose.training.synthesis.render.scene_pair import render_scene_pair

Change = Literal["roll 90", "roll 180", "4x zoom", "night", "moving object"]
_VIEW = (800, 600)  # pixels of the views with procedural textures, and of the facade


@dataclass(frozen=True)
class Group:
    """A row of the table: its pairs' names, known before they are made. Each iteration makes them
    anew."""

    name: str
    kind: PairKind
    names: Sequence[str]
    make: Callable[[], Iterator[PosedPair]]  # their ids are still to be put in

    @property
    def ids(self) -> list[Ids]:
        return [{"name": name, "group": self.name, "kind": self.kind} for name in self.names]

    def __iter__(self) -> Iterator[PosedPair]:
        for ids, pair in zip(self.ids, self.make(), strict=True):
            yield replace(pair, truth=replace(pair.truth, ids=ids))


class VerdictPairs(PairSet[VerdictScore]):
    """Groups of pairs, one after the other."""

    def __init__(self, groups: Sequence[Group]) -> None:
        super().__init__(VerdictScore, [ids for group in groups for ids in group.ids])
        self.groups = groups

    def read(self, first: int = 0) -> Iterator[PosedPair]:
        return islice(chain.from_iterable(self.groups), first, None)


def unrelated_photos(photos: Path, count: int, seed: int) -> Group:
    """Pairs of different photographs, of those that training holds back, with the cameras that they
    suggest.

    Raises InputError if there are not two.
    """
    paths = held_back_paths(photos)
    if len(paths) < 2:
        raise InputError(f"{photos}: {len(paths)} photographs that training holds back; need two")
    rng = np.random.default_rng(seed)
    drawn = [rng.choice(len(paths), 2, replace=False) for _ in range(count)]
    return _unrelated("other photographs", [(paths[i], paths[j]) for i, j in drawn])


def unrelated_scenes(folders: Sequence[Path], count: int, seed: int) -> Group:
    """Pairs of photographs of two scenes; each folder holds the photographs of one.

    Raises InputError if there are not two folders with photographs.
    """
    scenes = []
    for folder in folders:
        scenes.append([folder / name for name in search_images(folder).names if "/" not in name])
        if not scenes[-1]:
            raise InputError(f"{folder}: no photographs")
    if len(scenes) < 2:
        raise InputError("unrelated pairs need the folders of two scenes at least")
    rng = np.random.default_rng(seed)
    drawn = []
    for _ in range(count):
        i, j = rng.choice(len(scenes), 2, replace=False)
        path1, path2 = (scenes[k][rng.integers(len(scenes[k]))] for k in (i, j))
        drawn.append((path1, path2))
    return _unrelated("other scenes", drawn)


def rendered(photos: Path, count: int, seed: int) -> Group:
    """True pairs of 5 to 40 degrees, see `RenderedPosedPairs`."""
    pairs = RenderedPosedPairs(photos, count, seed)
    names = [f"rendered {seed} {number}" for number in range(count)]
    return Group("rendered, 5 to 40 deg", "true", names, pairs.read)


def listed(pair_list: Path, root: Path | None, limit: int | None) -> Group:
    """True pairs of a list, `limit` of them at most, evenly chosen. Raises as `read_pairs` does."""
    pairs = read_pairs(pair_list, root)
    require_images(pairs)
    chosen = np.linspace(0, len(pairs) - 1, min(limit or len(pairs), len(pairs))).round()
    pairs = [pairs[int(k)] for k in chosen]
    names = [f"{pair_list.stem} {pair.name1} {pair.name2}" for pair in pairs]
    return Group(pair_list.stem, "true", names, ListedPairs(pairs).read)


def misleading(photos: Path, count: int, seed: int) -> list[Group]:
    """`count` pairs of each kind that misleads: planes, rotations alone, forward motion, facades,
    and rendered pairs whose second view is rolled, zoomed or taken at night, and before which a
    flat object moves that covers 10 to 60 % of the images."""
    seeds = range(seed, seed + count)
    groups = [_scenes(kind, seeds) for kind in ("planar", "rotation_only", "forward")]
    groups.append(
        Group("facade", "true", [f"facade {k}" for k in seeds], lambda: map(facade, seeds))
    )
    true = rendered(photos, count, seed + 1)
    return groups + [_changed_views(true, change, seed) for change in get_args(Change)]


def changed(pair: PosedPair, change: Change, seed: int) -> PosedPair:
    """A true pair with another second view, or two others, and the pose that belongs to it."""
    camera2, pixels, R = pair.truth.camera2, pair.image2.pixels, np.eye(3)
    image1 = pair.image1
    if change == "moving object":
        rng = np.random.default_rng(seed)
        cameras, share = (pair.truth.camera1, camera2), rng.uniform(0.1, 0.6)
        pixels1, pixels = with_moving_object((image1.pixels, pixels), cameras, rng, share)
        image1 = Image(pixels1, f"{image1.name}, {change}")
    elif change == "4x zoom":
        pixels, camera2 = middle_quarter(pixels, camera2)
    elif change == "night":
        pixels = night(pixels, np.random.default_rng(seed))
    else:
        pixels, camera2, R = rolled(pixels, camera2, 1 if change == "roll 90" else 2)
    image2 = Image(np.ascontiguousarray(pixels), f"{pair.image2.name}, {change}")
    return PosedPair(pair.truth.turned(R, camera2), image1, image2)


def facade(seed: int) -> PosedPair:
    """See `render_facade`."""
    left, right, camera, R, t = render_facade(seed, _VIEW)
    return PosedPair(Truth({}, camera, camera, R, t), Image(left), Image(right))


def _unrelated(name: str, drawn: Sequence[tuple[Path, Path]]) -> Group:
    names = [" ".join(f"{path.parent.name}/{path.name}" for path in pair) for pair in drawn]
    return Group(name, "unrelated", names, lambda: (unrelated_pair(*pair) for pair in drawn))


def _changed_views(pairs: Group, change: Change, seed: int) -> Group:
    names = [f"{name}, {change}" for name in pairs.names]

    def make() -> Iterator[PosedPair]:
        return (changed(pair, change, seed + number) for number, pair in enumerate(pairs))

    return Group(change, "true", names, make)


def _scenes(kind: SceneKind, seeds: Sequence[int]) -> Group:
    rotated = kind == "rotation_only"

    def make() -> Iterator[PosedPair]:
        for seed in seeds:
            pair = render_scene_pair(seed, size1=_VIEW, size2=_VIEW, rotation_deg=12.0, kind=kind)
            camera1, camera2 = (Camera(K, _VIEW) for K in (pair.K1, pair.K2))
            truth = Truth({}, camera1, camera2, pair.R, None if rotated else pair.t)
            yield PosedPair(truth, Image(pair.image1), Image(pair.image2))

    names = [f"{kind} {seed}" for seed in seeds]
    return Group(kind.replace("_", " "), "rotation only" if rotated else "true", names, make)
