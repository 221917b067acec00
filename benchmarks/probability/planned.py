"""The pairs of a plan's entries, each made when it is matched."""

from collections.abc import Callable
from dataclasses import dataclass
from functools import partial
from pathlib import Path
from typing import Literal, get_args

import cv2
import numpy as np

from dgc_pose.benchmarks.posed_pairs import (
    ListedPairs,
    PosedPair,
    Truth,
    posed_pair,
    require_images,
)
from dgc_pose.benchmarks.probability.altered import ALTERATIONS, altered
from dgc_pose.benchmarks.probability.drawn import (
    drawn_dtu,
    drawn_posed,
    drawn_rgbd,
    drawn_sparse,
)
from dgc_pose.benchmarks.probability.plan import PlanEntry
from dgc_pose.cameras.camera import Camera
from dgc_pose.cameras.pair_list import Pair, read_pairs, write_pairs
from dgc_pose.cameras.prior import auto_camera
from dgc_pose.errors import InputError
from dgc_pose.files.outputs import replaced
from dgc_pose.images.folder import search_images
from dgc_pose.images.image import Image, load_image

BlankKind = Literal["even", "gradient", "vignette", "noise", "lens cap", "stripes", "sky"]
BLANKS: tuple[BlankKind, ...] = get_args(BlankKind)
PLANE_SIZE = 640  # pixels a side of a view
_RENDERED_SIZE = 640
_PLANE_PHOTO = 480  # pixels a side of a photograph on a plane, which a view shows a few of
_BLANK_SIZE = (640, 480)
Maker = Callable[[int], PosedPair]  # of a pair by its number
_DRAWN = {"rgbd": drawn_rgbd, "sparse": drawn_sparse, "posed": drawn_posed, "dtu": drawn_dtu}


@dataclass(frozen=True)
class PlannedPair:
    """A pair of an entry, not read yet."""

    entry: PlanEntry
    number: int
    scene: str
    make: Callable[[], PosedPair]


def planned(entry: PlanEntry, data: Path, lists: Path) -> list[PlannedPair]:
    """The pairs of an entry. Pairs that are drawn are written as a list to the folder `lists`, and
    read from there the next time.

    Raises InputError or ImageError if the data are not as the plan has them.
    """
    folders = [data / path for path in entry.path]
    makers = {
        "rendered": _rendered,
        "planes": _planes,
        "unrelated": _unrelated,
        "textureless": _textureless,
    }
    if entry.kind in makers:
        make, scenes = makers[entry.kind](folders, entry), entry.pairs * [entry.name]
    else:
        pairs = _listed(entry, folders[0], lists)
        require_images(pairs)
        make = ListedPairs(pairs).pair
        scenes = [Path(p.name1).parts[0] if entry.scene_by_folder else entry.name for p in pairs]
    return [PlannedPair(entry, k, name, _maker(entry, make, k)) for k, name in enumerate(scenes)]


def _maker(entry: PlanEntry, make: Maker, number: int) -> Callable[[], PosedPair]:
    if not entry.altered:
        return partial(make, number)
    return lambda: altered(make(number), ALTERATIONS[number % len(ALTERATIONS)])


def _listed(entry: PlanEntry, path: Path, lists: Path) -> list[Pair]:
    if entry.kind == "list":
        pairs = read_pairs(path)
        return pairs[:: max(1, -(-len(pairs) // entry.pairs))]
    known = lists / f"{entry.name}.txt"
    if not known.is_file():
        lists.mkdir(parents=True, exist_ok=True)
        with replaced(known) as stage:
            pairs = _DRAWN[entry.kind](path, entry.pairs, entry.seed)
            if unknown := set(entry.without) - {Path(pair.name1).parts[0] for pair in pairs}:
                raise InputError(f"{path}: no pairs of {min(unknown)}, which without names")
            write_pairs(stage, [p for p in pairs if Path(p.name1).parts[0] not in entry.without])
    return read_pairs(known, path)


def _rendered(folders: list[Path], entry: PlanEntry) -> Maker:
    from dgc_pose.training.draw import Draw
    from dgc_pose.training.photos import load_held_back
    from dgc_pose.training.room_pairs import RoomOptions, room_pairs

    photos = load_held_back(folders[0])
    options = RoomOptions(
        orbit_deg=(5.0, 70.0), enough=0.15, tries=6, spans=((1.5, 3.0), (0.9, 1.8))
    )
    shape = _RENDERED_SIZE, _RENDERED_SIZE

    def make(number: int) -> PosedPair:
        draw = Draw("cpu", "rendered", entry.seed, number)
        return posed_pair(room_pairs(photos, 1, shape, draw, options), {})

    return make


def _planes(folders: list[Path], entry: PlanEntry) -> Maker:
    """Planes with a relief, whose homographies have two poses; see `planes`. The heights of the
    reliefs come in turn."""
    from dgc_pose.benchmarks.probability.planes import RELIEFS, plane_pair
    from dgc_pose.training.draw import Draw
    from dgc_pose.training.photos import load_held_back

    photos = load_held_back(folders[0], _PLANE_PHOTO)

    def make(number: int) -> PosedPair:
        draw = Draw("cpu", "planes", entry.seed, number)
        return posed_pair(plane_pair(photos, PLANE_SIZE, draw, RELIEFS[number % len(RELIEFS)]), {})

    return make


def _unrelated(folders: list[Path], entry: PlanEntry) -> Maker:
    """Photographs of different places: of different folders, or two of a folder of photographs that
    have a place each."""
    paths = _photographs_in(folders)
    one_each = {path for path in paths if "photos" in path.parts and "more" not in path.parts}
    rng = np.random.default_rng(entry.seed)
    chosen: list[tuple[Path, Path]] = []
    while len(chosen) < entry.pairs:
        path1, path2 = (paths[k] for k in rng.integers(0, len(paths), 2))
        if path1.parent != path2.parent or (path1 in one_each and path1 != path2):
            chosen.append((path1, path2))

    def make(number: int) -> PosedPair:
        """The cameras that the images suggest (see `auto_camera`) are taken as known."""
        images = [load_image(path) for path in chosen[number]]
        camera1, camera2 = (Camera(auto_camera(image).K, image.size) for image in images)
        return PosedPair(Truth({}, camera1, camera2, None, None), *images)

    return make


def _textureless(folders: list[Path], entry: PlanEntry) -> Maker:
    """Each kind of blank image with itself, with another and with a photograph, in turn."""
    paths = _photographs_in(folders)

    def make(number: int) -> PosedPair:
        rng = np.random.default_rng([entry.seed, number])
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

    return make


def blank(kind: BlankKind, size: tuple[int, int], rng: np.random.Generator) -> np.ndarray:
    """An image (H, W, 3) uint8, of `size` (width, height), that no pose can be found from; as a
    camera stores it: as JPEG."""
    width, height = size
    y, x = np.mgrid[:height, :width] / max(size)
    angle = rng.uniform(0, np.pi)
    along = np.cos(angle) * x + np.sin(angle) * y
    if kind == "even":
        grey = np.full((height, width), rng.choice([0.0, 255.0, rng.uniform(0, 255)]))
    elif kind == "gradient":
        grey = rng.uniform(0, 128) + rng.uniform(10, 127) * (1 + along) / 2
    elif kind == "vignette":
        squared = (x - x.mean()) ** 2 + (y - y.mean()) ** 2
        grey = rng.uniform(60, 250) * np.exp(-rng.uniform(0.3, 2) * squared)
    elif kind == "noise":
        grey = 128 + rng.uniform(5, 60) * rng.standard_normal((height, width))
    elif kind == "lens cap":
        grey = rng.uniform(0, 4) + rng.uniform(0.5, 6) * rng.standard_normal((height, width))
    elif kind == "stripes":
        wave = np.sin(2 * np.pi * rng.uniform(8, 60) * along)
        grey = 128 + rng.uniform(20, 120) * (wave if rng.random() < 0.5 else np.sign(wave))
    else:  # burnt-out above, a smooth field below
        horizon = height * rng.uniform(0.3, 0.7) + 0.05 * width * (x - 0.5)
        grey = np.where(y * max(size) < horizon, 255.0, rng.uniform(20, 120) + 40 * y)
    tint = rng.uniform(0.8, 1.0, 3)
    pixels = (grey[..., None] * tint).clip(0, 255).round().astype(np.uint8)
    quality = int(rng.integers(60, 100))
    encoded = cv2.imencode(".jpg", pixels, [cv2.IMWRITE_JPEG_QUALITY, quality])[1]
    return np.ascontiguousarray(cv2.imdecode(encoded, cv2.IMREAD_COLOR))


def _photographs_in(folders: list[Path]) -> list[Path]:
    return [p for f in folders for p in sorted(f / name for name in search_images(f).names)]
