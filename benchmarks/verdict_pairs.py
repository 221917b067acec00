"""Pairs that the verdict is measured on: unrelated images, true pairs, and ones that mislead.

What a user named is checked when a function is called; images are read pair by pair.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass, replace
from itertools import chain, islice
from pathlib import Path
from typing import Literal, get_args

import cv2
import numpy as np

from dgc_pose.benchmarks.pair_list import read_pairs
from dgc_pose.benchmarks.posed_pairs import (
    Ids,
    ListedPairs,
    PairSet,
    PosedPair,
    RenderedPairs,
    Truth,
    require_images,
)
from dgc_pose.benchmarks.verdicts import PairKind, VerdictScore
from dgc_pose.camera import Camera, guess_camera
from dgc_pose.errors import InputError
from dgc_pose.image import Image, load_image
from dgc_pose.synthesis.photos import held_back_paths
from dgc_pose.synthesis.render.scene_pair import PairKind as SceneKind
from dgc_pose.synthesis.render.scene_pair import render_scene_pair

Parts = tuple[Image, Image, Truth]  # of a pair, whose ids are still to be put in
Change = Literal["roll 90", "roll 180", "4x zoom", "night"]
_SUFFIXES = {".jpg", ".jpeg", ".png", ".bmp", ".ppm", ".tif", ".tiff"}
_VIEW = (800, 600)  # pixels of the views with procedural textures, and of the facade
_FLOORS, _COLUMNS = 7, 10  # windows of the facade


@dataclass(frozen=True)
class Group:
    """A row of the table: its pairs' names, known before they are made. Each iteration makes them
    anew."""

    name: str
    kind: PairKind
    names: Sequence[str]
    make: Callable[[], Iterator[Parts]]

    @property
    def ids(self) -> list[Ids]:
        return [{"name": name, "group": self.name, "kind": self.kind} for name in self.names]

    def __iter__(self) -> Iterator[PosedPair]:
        for ids, (image1, image2, truth) in zip(self.ids, self.make(), strict=True):
            yield PosedPair(replace(truth, ids=ids), image1, image2)


class VerdictPairs(PairSet[VerdictScore]):
    """Groups of pairs, one after the other."""

    def __init__(self, groups: Sequence[Group]) -> None:
        super().__init__(VerdictScore, [ids for group in groups for ids in group.ids])
        self.groups = groups

    def read(self, first: int = 0) -> Iterator[PosedPair]:
        return islice(chain.from_iterable(self.groups), first, None)


def unrelated_photos(photos: Path, count: int, seed: int) -> Group:
    """Pairs of different photographs, of those that training holds back, with guessed cameras.

    Raises InputError if there are not two.
    """
    paths = held_back_paths(photos)
    if len(paths) < 2:
        raise InputError(f"{photos}: {len(paths)} photographs that training holds back; need two")
    rng = np.random.default_rng(seed)
    drawn = [rng.choice(len(paths), 2, replace=False) for _ in range(count)]
    return _unrelated("other photographs", [(paths[one], paths[other]) for one, other in drawn])


def unrelated_scenes(folders: Sequence[Path], count: int, seed: int) -> Group:
    """Pairs of photographs of two scenes; each folder holds the photographs of one.

    Raises InputError if there are not two folders with photographs.
    """
    scenes = []
    for folder in folders:
        found = sorted(p for p in folder.glob("*") if p.suffix.lower() in _SUFFIXES)
        if not found:
            raise InputError(f"{folder}: no photographs")
        scenes.append(found)
    if len(scenes) < 2:
        raise InputError("unrelated pairs need the folders of two scenes at least")
    rng = np.random.default_rng(seed)
    drawn = []
    for _ in range(count):
        one, other = rng.choice(len(scenes), 2, replace=False)
        first, second = (scenes[k][rng.integers(len(scenes[k]))] for k in (one, other))
        drawn.append((first, second))
    return _unrelated("other scenes", drawn)


def rendered(photos: Path, count: int, seed: int) -> Group:
    """True pairs of 5 to 40 degrees, see `RenderedPairs`."""
    pairs = RenderedPairs(photos, count, seed)
    names = [f"rendered {seed} {number}" for number in range(count)]
    return Group("rendered, 5 to 40 deg", "true", names, lambda: map(_parts, pairs.read()))


def listed(pair_list: Path, root: Path | None, limit: int | None) -> Group:
    """True pairs of a list, `limit` of them at most, evenly chosen. Raises as `read_pairs` does."""
    pairs = read_pairs(pair_list, root)
    require_images(pairs)
    chosen = np.linspace(0, len(pairs) - 1, min(limit or len(pairs), len(pairs))).round()
    kept = [pairs[int(k)] for k in chosen]
    names = [f"{pair_list.stem} {pair.name1} {pair.name2}" for pair in kept]
    return Group(pair_list.stem, "true", names, lambda: map(_parts, ListedPairs(kept).read()))


def misleading(photos: Path, count: int, seed: int) -> list[Group]:
    """`count` pairs of each kind that misleads: planes, rotations alone, forward motion, facades,
    and rendered pairs whose second view is rolled, zoomed or taken at night."""
    seeds = range(seed, seed + count)
    groups = [_scenes(kind, seeds) for kind in ("planar", "rotation_only", "forward")]
    groups.append(
        Group("facade", "true", [f"facade {k}" for k in seeds], lambda: map(facade, seeds))
    )
    true = rendered(photos, count, seed + 1)
    return groups + [changed_views(true, change, seed) for change in get_args(Change)]


def changed_views(pairs: Group, change: Change, seed: int) -> Group:
    """True pairs with another second view each, and the poses that belong to them."""
    names = [f"{name}, {change}" for name in pairs.names]
    return Group(change, "true", names, lambda: (changed(pair, change, seed) for pair in pairs))


def changed(pair: PosedPair, change: Change, seed: int) -> Parts:
    """A true pair with another second view, and the pose that belongs to it."""
    truth, pixels = pair.truth, pair.image2.pixels
    if change in ("roll 90", "roll 180"):
        for _ in range(1 if change == "roll 90" else 2):
            pixels, truth = _rolled(pixels, truth)
    elif change == "4x zoom":
        height, width = pixels.shape[:2]
        x, y = 3 * width // 8, 3 * height // 8
        pixels = pixels[y : y + height // 4, x : x + width // 4]
        K = truth.camera2.K.copy()
        K[:2, 2] -= (x, y)
        truth = replace(truth, camera2=Camera(K, (pixels.shape[1], pixels.shape[0])))
    else:
        pixels = _night(pixels, np.random.default_rng(seed))
    image2 = Image(np.ascontiguousarray(pixels), f"{pair.image2.name}, {change}")
    return pair.image1, image2, truth


def facade(seed: int) -> Parts:
    """Two views, 20 degrees apart, of a wall whose windows are alike but for their curtains."""
    rng = np.random.default_rng(seed)
    wall = _wall(rng)
    width, height = _VIEW
    K = np.array([[width, 0, (width - 1) / 2], [0, width, (height - 1) / 2], [0, 0, 1.0]])
    across = 1.6 / wall.shape[1]  # the wall is 1.6 wide and stands before the cameras at 1.2
    # From pixels of the wall (x, y, 1) to points in the frame between the cameras.
    plane = np.array(
        [[across, 0, -0.8], [0, across, -across * wall.shape[0] / 2], [0, 0, 1.2]]
    )
    angle = np.radians(rng.uniform(8, 12))
    middle = np.array([0, 0, 1.2])
    rotations = [cv2.Rodrigues(np.array([0.0, side, 0.0]))[0] for side in (-angle, angle)]
    shifts = [middle - rotation @ middle for rotation in rotations]
    left, right = (
        cv2.warpPerspective(
            wall,
            K @ (rotation @ plane + np.outer(shift, (0, 0, 1))),
            _VIEW,
            flags=cv2.INTER_AREA,
            borderValue=(150, 180, 210),
        )
        for rotation, shift in zip(rotations, shifts, strict=True)
    )
    R = rotations[1] @ rotations[0].T
    camera = Camera(K, _VIEW)
    truth = Truth({}, camera, camera, R, shifts[1] - R @ shifts[0])
    return Image(np.ascontiguousarray(left)), Image(np.ascontiguousarray(right)), truth


def _unrelated(name: str, drawn: Sequence[tuple[Path, Path]]) -> Group:
    def make() -> Iterator[Parts]:
        for pair in drawn:
            first, second = (load_image(path) for path in pair)
            camera1, camera2 = (guess_camera(path) for path in pair)
            yield first, second, Truth({}, camera1, camera2, None, None)

    names = [" ".join(f"{path.parent.name}/{path.name}" for path in pair) for pair in drawn]
    return Group(name, "unrelated", names, make)


def _scenes(scene: SceneKind, seeds: Sequence[int]) -> Group:
    rotated = scene == "rotation_only"

    def make() -> Iterator[Parts]:
        for seed in seeds:
            pair = render_scene_pair(seed, size1=_VIEW, size2=_VIEW, rotation_deg=12.0, kind=scene)
            camera1, camera2 = (Camera(K, _VIEW) for K in (pair.K1, pair.K2))
            truth = Truth({}, camera1, camera2, pair.R, None if rotated else pair.t)
            yield Image(pair.image1), Image(pair.image2), truth

    names = [f"{scene} {seed}" for seed in seeds]
    return Group(scene.replace("_", " "), "rotation only" if rotated else "true", names, make)


def _parts(pair: PosedPair) -> Parts:
    return pair.image1, pair.image2, pair.truth


def _rolled(pixels: np.ndarray, truth: Truth) -> tuple[np.ndarray, Truth]:
    """Image 2 rotated by 90 degrees counterclockwise: (x, y) goes to (y, width - 1 - x)."""
    width, K = pixels.shape[1], truth.camera2.K
    rotated = np.array(
        [[K[1, 1], 0, K[1, 2]], [0, K[0, 0], width - 1 - K[0, 2]], [0, 0, 1]], dtype=np.float64
    )
    roll = np.array([[0, 1, 0], [-1, 0, 0], [0, 0, 1.0]])
    camera2 = Camera(rotated, (pixels.shape[0], width))
    R, t = (None if part is None else roll @ part for part in (truth.R, truth.t))
    return np.rot90(pixels), replace(truth, camera2=camera2, R=R, t=t)


def _night(pixels: np.ndarray, rng: np.random.Generator) -> np.ndarray:
    """A tenth of the light, blue, with the noise of a sensor, and four lamps."""
    light = (pixels / 255.0) ** 2.2
    height, width = light.shape[:2]
    y, x = np.mgrid[:height, :width]
    lamps = np.zeros((height, width))
    for _ in range(4):
        centre = rng.random(2) * (width, height)
        squared = (x - centre[0]) ** 2 + (y - centre[1]) ** 2
        lamps += np.exp(-squared / (2 * (0.12 * width) ** 2))
    dark = light * (0.06 * np.array([0.7, 0.8, 1.2]) + 0.25 * lamps[..., None] * (1.2, 1, 0.6))
    dark = dark + 0.004 * rng.standard_normal(dark.shape)
    return (255 * dark.clip(0, 1) ** (1 / 2.2)).round().astype(np.uint8)


def _wall(rng: np.random.Generator) -> np.ndarray:
    """A facade (H, W, 3) uint8: bricks, and a grid of windows that differ in their curtains."""
    cell = 120
    bricks = np.full((cell, cell, 3), (160, 110, 90), np.uint8)
    bricks[::12] = (190, 180, 170)
    for row in range(0, cell, 12):
        bricks[row : row + 12, (row // 12 % 2) * 12 :: 24] = (190, 180, 170)
    bricks[30:95, 35:85] = (235, 235, 230)
    bricks[34:91, 39:81] = (60, 70, 85)
    bricks[61:64, 39:81] = bricks[34:91, 59:61] = (235, 235, 230)
    wall = np.tile(bricks, (_FLOORS, _COLUMNS, 1))
    for floor in range(_FLOORS):
        for column in range(_COLUMNS):
            y, x = floor * cell, column * cell
            drawn = int(rng.integers(0, 27))
            wall[y + 34 : y + 34 + drawn, x + 39 : x + 59] = rng.integers(120, 255, 3)
            wall[y + 34 : y + 34 + drawn, x + 61 : x + 81] = rng.integers(120, 255, 3)
    grain = rng.normal(0, 6, wall.shape[:2])[..., None]
    return (wall + grain).clip(0, 255).round().astype(np.uint8)
