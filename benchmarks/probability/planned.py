"""The plan of a fit: a JSON list of entries, each with its part, and the pairs of the entries.

    {"name": "hololens", "part": "fit", "kind": "list", "path": "rgbd/hololens"}

Paths are relative to the data folder. Each scene has one part, so that pairs of one place are
never both fitted and reported. Kinds:

- `list`: the pairs of `lists/NAME.txt.gz` beside the plan, in SuperGlue's format; image names are
  relative to the folder `path`.
- `pasted`: a `list` whose image 2 keeps a part and gets other surroundings. The pair shows two
  places that look alike in this part, and has no pose.
- `wrong_k`: a `list` whose K states a wrong focal length; the pose may still be right.
- `mirrored`: a `list` whose image 2 is mirrored left to right, so it has no pose.
- `turned`: two views of image 1 of a `list` by a camera that only turns; of every second pair K
  is wrong.
- `board`: a flat picture that fills most of both images, seen by a camera that moved; in every
  second pair the picture itself moved before a still camera, and there is no pose.
- `unrelated`: photographs of two places; the list has only their names.
- `rendered`: rendered rooms; `path` is a folder of photographs for textures.
- `planes`: like `rendered`, with a plane with a relief, whose homography has two poses.

Each pair is made when it is matched.
"""

import gzip
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from functools import partial
from pathlib import Path
from typing import Literal

import numpy as np

from dgc_pose.benchmarks.posed_pairs import ListedPairs, PosedPair
from dgc_pose.benchmarks.probability.kinds import ALTERATIONS, LIST_KINDS, altered
from dgc_pose.cameras.camera import Camera
from dgc_pose.cameras.pair_list import read_pairs
from dgc_pose.cameras.prior import auto_camera
from dgc_pose.errors import InputError, reason
from dgc_pose.images.image import Image, load_image
from dgc_pose.system.options import check_options, option
from dgc_pose.system.texts import read_json

Part = Literal["fit", "report"]
EntryKind = Literal[
    "list",
    "pasted",
    "wrong_k",
    "turned",
    "mirrored",
    "board",
    "unrelated",
    "rendered",
    "planes",
]
DEFAULT_PLAN = Path(__file__).with_name("plan.json")
VIEW_SIZE = 640  # pixels a side of a rendered view
_PLANE_PHOTO = 480  # pixels, shorter side of a photograph on a plane: a view shows only a few


@dataclass(frozen=True)
class PlanEntry:
    """One line of a plan."""

    name: str  # of the entry's files; also the scene, unless `scene_by_folder`
    part: Part = option()
    kind: EntryKind = option()
    path: Path = Path()  # within the data folder
    pairs: int = option(60, min=1)  # number of pairs, for kinds without a list
    each: int = option(0, min=0)  # most pairs of a scene, spread over all of them; 0: all pairs
    seed: int = option(0, min=0)
    listed: str = ""  # name of the file of pairs in the folder lists; "": that of the entry
    scene_by_folder: bool = False  # for lists: the scene is the first folder of an image's name
    altered: bool = False  # whether each pair is changed by one of ALTERATIONS, in turn
    # Scenes whose true poses come from a tracker and are off by a degree or more: they separate
    # right poses from wrong ones, but do not measure accuracy.
    rough: Sequence[str] = ()
    # Each of so many pairs of a scene is also estimated without K; 0: none is. A plane does not
    # determine the focal length, so many planes would add little to the fit.
    withheld: int = option(1, min=0)

    def __post_init__(self) -> None:
        check_options(self)


def read_plan(path: Path) -> list[PlanEntry]:
    """The entries of a plan.

    Raises InputError, with the path, if the file is not a plan or two entries have one name.
    """
    data = read_json(path, "a plan")
    try:
        entries = [PlanEntry(**{**values, "path": Path(values.get("path", ""))}) for values in data]
    except (ValueError, TypeError, AttributeError) as error:
        raise InputError(f"{path}: not a plan ({reason(error)})") from None
    names = {entry.name for entry in entries}
    if len(names) < len(entries):
        raise InputError(f"{path}: two entries have one name")
    return entries


@dataclass(frozen=True)
class PlannedPair:
    """A pair of an entry, which `make` reads or renders."""

    entry: PlanEntry
    number: int
    scene: str
    make: Callable[[], PosedPair]
    turn: int = 0  # number among the pairs of its scene


def planned(entry: PlanEntry, data: Path, lists: Path) -> list[PlannedPair]:
    """The pairs of an entry.

    data: the folder that the plan's paths are relative to; lists: the folder of the entries' lists.
    Raises InputError or ImageError if the data do not match the plan.
    """
    folder = data / entry.path
    listed = lists / f"{entry.listed or entry.name}.txt.gz"
    scenes = entry.pairs * [entry.name]
    make: Callable[[int, np.random.Generator], PosedPair]  # by the number of the pair
    if entry.kind in LIST_KINDS:
        pairs = read_pairs(listed, folder)
        make = partial(LIST_KINDS[entry.kind], ListedPairs(pairs))
        scenes = [Path(p.name1).parts[0] if entry.scene_by_folder else entry.name for p in pairs]
    elif entry.kind == "unrelated":
        with gzip.open(listed, "rt", encoding="utf-8") as lines:
            names = [line.split() for line in lines]
        make = partial(_unrelated, [[folder / name for name in pair] for pair in names])
        scenes = len(names) * [entry.name]
    else:
        make = _rendered(folder, entry)

    def made(number: int) -> PosedPair:
        pair = make(number, np.random.default_rng([entry.seed, number]))
        way = ALTERATIONS[number % len(ALTERATIONS)]
        return altered(pair, way) if entry.altered else pair

    found = []
    for scene in dict.fromkeys(scenes):
        numbers = np.flatnonzero(np.equal(scenes, scene))
        if 0 < entry.each < len(numbers):
            numbers = numbers[np.linspace(0, len(numbers) - 1, entry.each).round().astype(int)]
        for turn, number in enumerate(numbers.tolist()):
            found.append(PlannedPair(entry, number, scene, partial(made, number), turn))
    return found


def _rendered(folder: Path, entry: PlanEntry) -> Callable[[int, np.random.Generator], PosedPair]:
    """A function that renders pairs of rooms, or of planes (see `planes`) with the heights of the
    relief in turn."""
    from dgc_pose.benchmarks.probability.planes import RELIEFS, plane_pair
    from dgc_pose.training.draw import Draw
    from dgc_pose.training.photos import SIDE, load_held_back
    from dgc_pose.training.room_pairs import RoomOptions, room_pairs
    from dgc_pose.training.views import image_arrays

    photos = load_held_back(folder, _PLANE_PHOTO if entry.kind == "planes" else SIDE)
    options = RoomOptions(
        orbit_deg=(5.0, 70.0), enough=0.15, tries=6, spans=((1.5, 3.0), (0.9, 1.8))
    )
    shape = VIEW_SIZE, VIEW_SIZE

    def make(number: int, rng: np.random.Generator) -> PosedPair:
        draw = Draw("cpu", entry.kind, entry.seed, number)
        if entry.kind == "planes":
            views = plane_pair(photos, VIEW_SIZE, draw, RELIEFS[number % len(RELIEFS)])
        else:
            views = room_pairs(photos, 1, shape, draw, options)
        both = views.maps.image1, views.maps.image2
        image1, image2 = (Image(image_arrays(pixels[:1])[0]) for pixels in both)
        camera1 = Camera(views.source.K[0].double().numpy(), image1.size)
        camera2 = Camera(views.target.K[0].double().numpy(), image2.size)
        pose = views.target.seen_by(views.source).pose[0].double().numpy()
        return PosedPair(image1, image2, camera1, camera2, pose[:, :3], pose[:, 3])

    return make


def _unrelated(paths: Sequence[Sequence[Path]], number: int, rng: np.random.Generator) -> PosedPair:
    """A pair of photographs of different places. The camera that `auto_camera` estimates for each
    counts as known."""
    image1, image2 = (load_image(path) for path in paths[number])
    camera1, camera2 = (Camera(auto_camera(image).K, image.size) for image in (image1, image2))
    return PosedPair(image1, image2, camera1, camera2, None, None)
