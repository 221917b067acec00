"""The pairs of a plan's sources, each made when it is matched."""

from __future__ import annotations

import os
from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass
from pathlib import Path

import cv2
import numpy as np

from dgc_pose.benchmarks.posed_pairs import ListedPairs, PosedPair, Truth, require_images
from dgc_pose.benchmarks.probability.blank import BLANKS, blank
from dgc_pose.benchmarks.probability.drawn import drawn_dtu, drawn_rgbd, drawn_sparse
from dgc_pose.benchmarks.probability.plan import Source
from dgc_pose.cameras.camera import Camera, guess_camera
from dgc_pose.cameras.pair_list import Pair, read_pairs, write_pairs
from dgc_pose.errors import InputError
from dgc_pose.files.outputs import replaced
from dgc_pose.images.folder import search_images
from dgc_pose.images.image import Image, load_image

_RENDERED_SIZE = 640  # pixels a side
_BLANK_SIZE = (640, 480)
_DRAWN = {"rgbd": drawn_rgbd, "sparse": drawn_sparse, "dtu": drawn_dtu}


@dataclass(frozen=True)
class PlannedPair:
    """One pair of a source, not read yet."""

    source: Source
    number: int
    scene: str
    make: Callable[[], PosedPair]


def require_data(sources: Sequence[Source], data: Path) -> None:
    """Raise InputError, with the path, if something that the sources name is not there."""
    for source in sources:
        for path in source.path:
            if not os.path.exists(data / path):  # False for a name with a zero byte, too
                raise InputError(
                    f"{data / path}: no such data; the plan's source {source.name} needs it"
                )


def planned(source: Source, data: Path, lists: Path) -> list[PlannedPair]:
    """The pairs of a source. Pairs that are drawn are written as a list to the folder `lists`, and
    read from there the next time.

    Raises InputError or ImageError if the data are not as the plan says.
    """
    require_data([source], data)
    folders = [data / path for path in source.path]
    if source.kind in ("rendered", "unrelated", "textureless"):
        makers = {"rendered": _rendered, "unrelated": _unrelated, "textureless": _textureless}
        made = makers[source.kind](folders, source)
        return [PlannedPair(source, k, source.name, make) for k, make in enumerate(made)]
    pairs = _listed(source, folders[0], lists)
    require_images(pairs)
    listed = ListedPairs(pairs)
    return [
        PlannedPair(source, k, _scene(source, pair), lambda k=k: listed.pair(k))  # type: ignore[misc]
        for k, pair in enumerate(pairs)
    ]


def _listed(source: Source, path: Path, lists: Path) -> list[Pair]:
    if source.kind == "list":
        pairs = read_pairs(path)
        return pairs[:: max(1, -(-len(pairs) // source.pairs))]
    known = lists / f"{source.name}.txt"
    if not known.is_file():
        lists.mkdir(parents=True, exist_ok=True)
        with replaced(known) as stage:
            write_pairs(stage, _DRAWN[source.kind](path, source.pairs, source.seed))
    return read_pairs(known, path)


def _scene(source: Source, pair: Pair) -> str:
    return Path(pair.name1).parts[0] if source.scene_by_folder else source.name


def _rendered(folders: list[Path], source: Source) -> Iterator[Callable[[], PosedPair]]:
    from dgc_pose.synthesis.photos import load_held_back
    from dgc_pose.synthesis.render import SceneOptions, render_pairs

    textures = load_held_back(folders[0]).textures
    scenes = SceneOptions(
        rotation_deg=(5.0, 70.0), roll_deg=8.0, min_overlap=0.15, texture_span=(0.3, 0.6)
    )

    def make(number: int) -> PosedPair:
        import torch

        generator = torch.Generator().manual_seed(1000 * source.seed + number)
        views = render_pairs(textures, 1, _RENDERED_SIZE, generator, scenes)
        pose = views.cam2_from_cam1[0].double().numpy()
        size = (_RENDERED_SIZE, _RENDERED_SIZE)
        camera1, camera2 = (Camera(K[0].double().numpy(), size) for K in (views.K1, views.K2))
        images = [
            Image((255 * view[0].permute(1, 2, 0)).round().byte().contiguous().numpy())
            for view in (views.image1, views.image2)
        ]
        return PosedPair(Truth({}, camera1, camera2, pose[:, :3], pose[:, 3]), *images)

    return ((lambda k=k: make(k)) for k in range(source.pairs))  # type: ignore[misc]


def _unrelated(folders: list[Path], source: Source) -> Iterator[Callable[[], PosedPair]]:
    """Photographs of different places: of different folders, or of different prefixes in one."""
    paths = _photographs_in(folders)
    places = {path: f"{path.parent} {path.stem.split('_')[0]}" for path in paths}
    one_each = {path for path in paths if "photos" in path.parts and "more" not in path.parts}
    rng = np.random.default_rng(source.seed)
    found: list[tuple[Path, Path]] = []
    while len(found) < source.pairs:
        first, second = (paths[k] for k in rng.integers(0, len(paths), 2))
        if places[first] == places[second] and not (first in one_each and first != second):
            continue
        found.append((first, second))
    return ((lambda pair=pair: _photographs(*pair)) for pair in found)  # type: ignore[misc]


def _textureless(folders: list[Path], source: Source) -> Iterator[Callable[[], PosedPair]]:
    """Each kind of blank image with itself, with another and with a photograph, in turn."""
    paths = _photographs_in(folders)

    def make(number: int) -> PosedPair:
        rng = np.random.default_rng([source.seed, number])
        kind, way = BLANKS[number % len(BLANKS)], number // len(BLANKS) % 3
        first = blank(kind, _BLANK_SIZE, rng)
        if way == 0:
            second = first.copy()
        elif way == 1:
            second = blank(BLANKS[rng.integers(len(BLANKS))], _BLANK_SIZE, rng)
        else:
            photo = load_image(paths[rng.integers(len(paths))]).pixels
            second = cv2.resize(photo, _BLANK_SIZE, interpolation=cv2.INTER_AREA)
        width, height = _BLANK_SIZE
        K = np.array([[width, 0, (width - 1) / 2], [0, width, (height - 1) / 2], [0, 0, 1]])
        camera = Camera(K.astype(np.float64), _BLANK_SIZE)
        return PosedPair(Truth({}, camera, camera, None, None), Image(first), Image(second))

    return ((lambda k=k: make(k)) for k in range(source.pairs))  # type: ignore[misc]


def _photographs_in(folders: list[Path]) -> list[Path]:
    return [p for f in folders for p in sorted(f / name for name in search_images(f).names)]


def _photographs(first: Path, second: Path) -> PosedPair:
    truth = Truth({}, guess_camera(first), guess_camera(second), None, None)
    return PosedPair(truth, load_image(first), load_image(second))
