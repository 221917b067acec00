"""The plan of a fit: a JSON list of entries, each with its part, and the pairs of the entries.

    {"name": "hololens", "part": "fit", "kind": "list", "path": "rgbd/hololens"}

Paths are relative to the data folder. Each scene has one part, so that pairs of one place are
never both fitted and reported. Kinds:

- `list`: the pairs of `lists/NAME.txt.gz` beside the plan, in SuperGlue's format; image names are
  relative to the folder `path`.
- `pasted`: a `list` whose image 2 keeps a part and gets other surroundings. The pair shows two
  places that look alike in this part, and has no pose.
- `zoomed`: a `list` whose images are both zoomed in, as by a longer lens; in every fourth pair only
  image 2 is, as by a zoom that no file states.
- `unrelated`: photographs of two places; the list has only their names.
- `rendered`: rendered rooms; `path` is a folder of photographs for textures.
- `planes`: like `rendered`, with a plane with a relief, whose homography has two poses.
- `textureless`: drawn images without structure, paired with each other and with photographs of
  `path`.

Each pair is made when it is matched.
"""

import gzip
import math
from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from functools import partial
from pathlib import Path
from typing import Literal, get_args

import cv2
import numpy as np

from dgc_pose.benchmarks.posed_pairs import ListedPairs, PosedPair
from dgc_pose.cameras.camera import Camera
from dgc_pose.cameras.pair_list import read_pairs
from dgc_pose.cameras.prior import auto_camera
from dgc_pose.errors import InputError, reason
from dgc_pose.images.folder import search_images
from dgc_pose.images.image import Image, load_image, resize
from dgc_pose.system.options import check_options, option
from dgc_pose.system.texts import read_json

Part = Literal["fit", "report"]
EntryKind = Literal["list", "pasted", "zoomed", "unrelated", "rendered", "planes", "textureless"]
DEFAULT_PLAN = Path(__file__).with_name("plan.json")
BlankKind = Literal["gradient", "noise", "stripes", "sky"]
BLANKS: tuple[BlankKind, ...] = get_args(BlankKind)
Alteration = Literal["swapped", "enlarged", "bordered", "turned", "darkened"]
ALTERATIONS: tuple[Alteration, ...] = get_args(Alteration)
_LONGER = (1.4, 3.0)  # factors of f
_ZOOM = (1.1, 1.6)  # factors of f
_ZOOM_EACH = 4  # every 4th pair has a zoom
_SCALE = 1.5
_BORDER = 0.1  # over the longer side
_GAMMA = 1.8
_TURN = np.array([[0.0, -1, 0], [1, 0, 0], [0, 0, 1]])  # to the axes of an image turned clockwise
VIEW_SIZE = 640  # pixels a side of a rendered view
_PLANE_PHOTO = 480  # pixels, shorter side of a photograph on a plane: a view shows only a few
_BLANK_SIZE = (640, 480)


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
    listed = lists / f"{entry.name}.txt.gz"
    scenes = entry.pairs * [entry.name]
    make: Callable[[int], PosedPair]  # by the number of the pair
    if entry.kind in ("list", "pasted", "zoomed"):
        pairs = read_pairs(listed, folder)
        of_list = ListedPairs(pairs)
        make = of_list.pair
        if entry.kind != "list":
            of_kind = _pasted if entry.kind == "pasted" else _zoomed
            make = partial(of_kind, of_list, entry.seed)
        scenes = [Path(p.name1).parts[0] if entry.scene_by_folder else entry.name for p in pairs]
    elif entry.kind == "unrelated":
        with gzip.open(listed, "rt", encoding="utf-8") as lines:
            names = [line.split() for line in lines]
        make = partial(_unrelated, [[folder / name for name in pair] for pair in names])
        scenes = len(names) * [entry.name]
    elif entry.kind == "textureless":
        paths = sorted(folder / name for name in search_images(folder).names)
        make = partial(_textureless, paths, entry.seed)
    else:
        make = _rendered(folder, entry)

    def made(number: int) -> PosedPair:
        pair = make(number)
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


def altered(pair: PosedPair, way: Alteration) -> PosedPair:
    """The pair with image 2 first or changed, with the true cameras and pose of the result."""
    pixels = pair.image2.pixels
    assert pair.R is not None and pair.t is not None
    K = pair.camera2.K.copy()
    R = pair.R
    t = pair.t
    height, width = pixels.shape[:2]
    if way == "swapped":
        return PosedPair(pair.image2, pair.image1, pair.camera2, pair.camera1, R.T, -R.T @ t)
    if way == "enlarged":
        size = (round(_SCALE * width), round(_SCALE * height))
        K = replace(pair.camera2, size=(width, height)).resized(size).K
        pixels = resize(pixels, size)
    elif way == "bordered":
        sides = 4 * (round(_BORDER * max(width, height)),)
        K[:2, 2] += sides[0]
        pixels = cv2.copyMakeBorder(pixels, *sides, cv2.BORDER_CONSTANT, value=(128, 128, 128))
    elif way == "turned":
        K[:2] = [K[1, 1], 0, height - 1 - K[1, 2]], [0, K[0, 0], K[0, 2]]
        pixels = np.ascontiguousarray(np.rot90(pixels, -1))
        R = _TURN @ R
        t = _TURN @ t
    else:
        pixels = (255 * (pixels / 255) ** _GAMMA).round().astype(np.uint8)
    image2 = replace(pair.image2, pixels=pixels)
    camera2 = replace(pair.camera2, K=K, size=image2.size)
    return replace(pair, image2=image2, camera2=camera2, R=R, t=t)


def _pasted(listed: ListedPairs, seed: int, number: int) -> PosedPair:
    """A pair of two places that look alike in part: image 2 keeps an ellipse; the rest is its own
    mirror image (odd numbers) or image 1 of another pair (even numbers)."""
    rng = np.random.default_rng([seed, number])
    pair = listed.pair(number)
    pixels = pair.image2.pixels
    height, width = size = pixels.shape[:2]
    if number % 2:
        other = np.roll(pixels[:, ::-1], rng.integers(width), 1)
    else:
        other = listed.pair(int(rng.integers(len(listed.pairs)))).image1.pixels
        factor = rng.uniform(1.0, 1.4) * max(np.divide(size, other.shape[:2]))
        other = resize(
            other, (math.ceil(factor * other.shape[1]), math.ceil(factor * other.shape[0]))
        )
    middle = rng.uniform(0.3, 0.7, 2) * (width, height)
    axes = rng.uniform(0.2, 0.42, 2) * (width, height)
    box = (middle.tolist(), (2 * axes).tolist(), float(rng.uniform(0, 180)))
    ellipse = cv2.ellipse(np.zeros(size, np.float32), box, 1.0, -1)
    mask = cv2.GaussianBlur(ellipse, (0, 0), 0.8)[..., None]
    pasted = mask * pixels + (1 - mask) * other[:height, :width]
    image2 = replace(pair.image2, pixels=pasted.round().astype(np.uint8))
    return replace(pair, image2=image2, R=None, t=None)


def _zoomed(listed: ListedPairs, seed: int, number: int) -> PosedPair:
    """A pair with longer lenses, or a zoom between its images: their middles, enlarged."""
    rng = np.random.default_rng([seed, number])
    pair = listed.pair(number)
    factors = np.full(2, np.exp(rng.uniform(*np.log(_LONGER))))
    if number % _ZOOM_EACH == 0:
        factors = np.array([1.0, rng.uniform(*_ZOOM)])
    images = []
    cameras = []
    for image, camera, factor in zip(
        (pair.image1, pair.image2), (pair.camera1, pair.camera2), factors, strict=True
    ):
        width, height = image.size
        part = round(width / factor), round(height / factor)
        left = (width - part[0]) // 2
        top = (height - part[1]) // 2
        pixels = image.pixels[top : top + part[1], left : left + part[0]]
        K = camera.K - np.array([[0, 0, left], [0, 0, top], [0, 0, 0]])
        images.append(replace(image, pixels=resize(np.ascontiguousarray(pixels), image.size)))
        cameras.append(replace(camera, K=K, size=part).resized(image.size))
    image1, image2 = images
    camera1, camera2 = cameras
    return PosedPair(image1, image2, camera1, camera2, pair.R, pair.t)


def _rendered(folder: Path, entry: PlanEntry) -> Callable[[int], PosedPair]:
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

    def make(number: int) -> PosedPair:
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


def _unrelated(paths: Sequence[Sequence[Path]], number: int) -> PosedPair:
    """A pair of photographs of different places. The camera that `auto_camera` estimates for each
    counts as known."""
    image1, image2 = (load_image(path) for path in paths[number])
    camera1, camera2 = (Camera(auto_camera(image).K, image.size) for image in (image1, image2))
    return PosedPair(image1, image2, camera1, camera2, None, None)


def _textureless(photographs: Sequence[Path], seed: int, number: int) -> PosedPair:
    """A blank image of each kind in turn, paired with itself, another blank or a photograph."""
    rng = np.random.default_rng([seed, number])
    kind = BLANKS[number % len(BLANKS)]
    way = number // len(BLANKS) % 3
    first = blank(kind, _BLANK_SIZE, rng)
    if way == 0:
        second = first.copy()
    elif way == 1:
        second = blank(BLANKS[rng.integers(len(BLANKS))], _BLANK_SIZE, rng)
    else:
        photo = load_image(photographs[int(rng.integers(len(photographs)))]).pixels
        second = cv2.resize(photo, _BLANK_SIZE, interpolation=cv2.INTER_AREA)
    width, height = _BLANK_SIZE
    K = np.array([[width, 0, (width - 1) / 2], [0, width, (height - 1) / 2], [0, 0, 1.0]])
    camera = Camera(K, _BLANK_SIZE)
    return PosedPair(Image(first), Image(second), camera, camera, None, None)


def blank(kind: BlankKind, size: tuple[int, int], rng: np.random.Generator) -> np.ndarray:
    """An image (H, W, 3) uint8, of `size` (width, height), without structure for a pose, after JPEG
    compression like a camera's."""
    width, height = size
    y, x = np.mgrid[:height, :width] / max(size)
    angle = rng.uniform(0, np.pi)
    along = np.cos(angle) * x + np.sin(angle) * y
    if kind == "gradient":
        grey = rng.uniform(0, 128) + rng.uniform(10, 127) * (1 + along) / 2
    elif kind == "noise":
        grey = 128 + rng.uniform(5, 60) * rng.standard_normal((height, width))
    elif kind == "stripes":
        wave = np.sin(2 * np.pi * rng.uniform(8, 60) * along)
        grey = 128 + rng.uniform(20, 120) * (wave if rng.random() < 0.5 else np.sign(wave))
    else:  # a saturated sky over a smooth field
        horizon = height * rng.uniform(0.3, 0.7) + 0.05 * width * (x - 0.5)
        grey = np.where(y * max(size) < horizon, 255.0, rng.uniform(20, 120) + 40 * y)
    tint = rng.uniform(0.8, 1.0, 3)
    pixels = (grey[..., None] * tint).clip(0, 255).round().astype(np.uint8)
    quality = int(rng.integers(60, 100))
    encoded = cv2.imencode(".jpg", pixels, [cv2.IMWRITE_JPEG_QUALITY, quality])[1]
    return np.ascontiguousarray(cv2.imdecode(encoded, cv2.IMREAD_COLOR))
