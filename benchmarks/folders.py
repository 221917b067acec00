"""The fit of `batch/look_alikes.py`: the weights of the evidence for each pair on its own.

The pairs come from two kinds of folders. The ray caster renders folders in which a place appears
twice, with the truth. Ordinary folders hold posed photographs.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from functools import cache, partial
from itertools import product
from math import cos, pi, sin
from pathlib import Path
from typing import NamedTuple

import cv2
import numpy as np
import torch
from sklearn.metrics import roc_auc_score

from dgc_pose.batch.look_alikes import (
    evidence_of_pairs,
    has_repeats,
    own_log_odds,
    solutions,
    triples,
)
from dgc_pose.batch.options import BatchOptions
from dgc_pose.batch.pairs import MIN_FOLDER_PROBABILITY, MatchedPair
from dgc_pose.batch.result import Batch, read_batch
from dgc_pose.batch.run import run_batch
from dgc_pose.batch.source import PairChoice, Source
from dgc_pose.benchmarks.models import thinned
from dgc_pose.benchmarks.probability.fitting import regression
from dgc_pose.benchmarks.report import decimals
from dgc_pose.cameras.by_image import Calibration
from dgc_pose.cameras.camera import Camera
from dgc_pose.estimation import EstimationOptions
from dgc_pose.matchers import MatcherOptions
from dgc_pose.metrics import rotation_error_deg, translation_error_deg
from dgc_pose.system.files import replaced_folder
from dgc_pose.system.texts import aligned
from dgc_pose.training.draw import Draw, other_light
from dgc_pose.training.photos import Photos, load_held_back
from dgc_pose.training.posed_frames import PosedFrame, read_scene
from dgc_pose.training.room_pairs import Rooms, random_textures, render
from dgc_pose.training.views import Cameras, Shape, about_axis, image_arrays

KINDS = ("rooms", "object", "tower", "shelf")
# By layer: half the length that a photograph covers, over the root of a box's median half size
_SPANS = ((0.4, 1.1), (0.25, 0.75))
_OTHER_LIGHT = 0.3  # share of the relit view in the photograph
_HOLDS = math.log(MIN_FOLDER_PROBABILITY / (1 - MIN_FOLDER_PROBABILITY))
_FRAMES = 13  # of a posed scene, evenly spread
_STEPS = (2, 3)  # every second and third of these frames are small folders of their own
_LANDS_PX = 8.0  # largest distance of a right inlier from its true point
_RIGHT_DEG = 10.0
_LEAST_BASELINE = 0.1  # over the depth, from which t counts
# Folder of images, their cameras by name, and a function: whether the pose of a pair is right
Folder = tuple[Path, Mapping[str, Camera], Callable[[MatchedPair], bool]]
# For the pairs with a pose: values (n, 3) of `evidence_of_pairs`, whether each pair is right (n,),
# triples (M, 3), and whether each triple agrees (M,)
Pairs = tuple[np.ndarray, np.ndarray, np.ndarray, np.ndarray]


@dataclass(frozen=True, eq=False)
class View:
    """A rendered photograph with its true camera and depths."""

    image: np.ndarray  # (h, w, 3) uint8, RGB
    camera: Cameras  # a single one
    depth: np.ndarray  # (h, w), along the optical axis, units of length
    part: str  # views of different parts show different places


class _Box(NamedTuple):
    centre: np.ndarray  # (3,), y down
    half: np.ndarray  # (3,), half sizes
    yaw: float
    seed: float  # of the textures


_Values = float | Sequence[float] | np.ndarray  # one value, or one for each axis
_Range = tuple[_Values, _Values]  # least and largest values
# Boxes, of which the first is the room; camera centres (n, 3); the points they look at (n, 3)
_Part = tuple[list[_Box], np.ndarray, np.ndarray]
_floats = partial(torch.as_tensor, dtype=torch.float32)


def rendered_folder(
    kind: str, photos: Photos, seed: int, shape: Shape = (480, 640)
) -> dict[str, View]:
    """Render a folder of one of `KINDS`, textured with photos: views by name, in random order."""
    make = _Maker(np.random.default_rng([seed, *kind.encode()]))
    draw = Draw("cpu", kind, seed)
    focal = make.between(0.66, 0.84) * shape[1]
    views = list[View]()
    K = _floats([[focal, focal, (shape[1] - 1) / 2, (shape[0] - 1) / 2]])
    for name, (boxes, centres, targets) in zip("AB", getattr(make, kind)(), strict=False):
        centre, half, yaw, seeds = (np.array(values) for values in zip(*boxes, strict=True))
        drawn = [random_textures(1, 1, photos, Draw("cpu", own), _SPANS) for own in seeds.tolist()]
        photo, span, origin, weight, gain = map(partial(torch.cat, dim=1), zip(*drawn, strict=True))
        span *= _floats(np.median(half, 1)).sqrt()[:, None, None]
        solids = about_axis(_floats(yaw), 1)[None], _floats(half)[None], _floats(centre)[None]
        rooms = Rooms(*solids, photo, span, origin, weight, gain, ellipsoids=0)
        for place, target in zip(_floats(centres), _floats(targets), strict=True):
            camera = Cameras.looking(K, place[None], target[None], 0.03 * draw.normal(1))
            image, depth = render(rooms, camera, shape, photos.bank)
            pixels = image_arrays(torch.lerp(image, other_light(image, draw), _OTHER_LIGHT))[0]
            views.append(View(pixels, camera, depth[0].numpy(), name))
    return {f"{k:02d}.png": views[j] for k, j in enumerate(make.rng.permutation(len(views)))}


def _copied(boxes: list[_Box], shift: _Values = 0, turn: float = 0) -> list[_Box]:
    """The same boxes elsewhere: turned about the vertical axis, then shifted."""
    R = np.array([[cos(turn), 0, sin(turn)], [0, 1, 0], [-sin(turn), 0, cos(turn)]])
    return [b._replace(centre=R @ b.centre + shift, yaw=b.yaw + turn) for b in boxes]


class _Maker:
    """Makes random boxes. The method with the name of a kind makes the parts of its folder."""

    def __init__(self, rng: np.random.Generator) -> None:
        self.rng = rng
        self.between = rng.uniform

    def boxes(self, count: int, halves: _Range, feet: _Range, yaw: float = 0) -> list[_Box]:
        """feet: range of the middles of the lower faces; yaw: largest, in either direction."""
        sizes = self.between(*halves, (count, 3))
        places = self.between(*feet, (count, 3))
        turns = self.between(-yaw, yaw, count)
        seeds = self.rng.random(count)
        return [*map(_Box, places - sizes * (0, 1, 0), sizes, turns, seeds)]

    def box(self, foot: _Values, half: _Values) -> list[_Box]:
        return self.boxes(1, (half, half), (foot, foot))

    def rooms(self) -> list[_Part]:
        """Two rooms with the same back wall and the same objects in front of it."""
        wide, y, deep = walls = self.between((2.0, 1.2, 2.0), (2.8, 1.5, 2.8))
        x = wide - 0.5
        alike = self.box((0, y, deep), (wide, y, 0.01))
        parts = list[_Part]()
        feet = (-x, y, deep - 0.6), (x, y, deep - 0.3)
        alike += self.boxes(4, ((0.15, 0.1, 0.1), (0.5, 0.7, 0.3)), feet, 0.2)
        for _ in range(2):
            own = self.boxes(6, (0.1, 0.5), ((-x, y, 0.5 - deep), (x, y, deep - 1)), pi)
            centres = self.between((-x, -0.5, -0.8 * deep), (x, 0.1, deep - 1.6), (6, 3))
            targets = self.between((-x, -0.3, deep), (x, 0.4, deep), (6, 3))
            parts.append((self.box((0, y, 0), walls) + alike + own, centres, targets))
        return parts

    def object(self) -> list[_Part]:
        """An object of two boxes, twice in one room, and a path from one copy to the other."""
        _, y, _ = walls = self.between((5.0, 1.5, 4.0), (7.0, 2.5, 5.0))
        thing = self.boxes(1, ((0.25, 0.4, 0.25), (0.45, 0.7, 0.45)), ((0, y, 0), (0, y, 0)), 0.4)
        thing += self.boxes(1, (0.1, 0.3), ((-0.5, y, -0.6), (0.5, y, -0.4)), 1)
        left, right = self.between(((-2.4, 0, 0), (1.5, 0, -0.5)), ((-1.5, 0, 0), (2.4, 0, 0.5)))
        boxes = self.box((0, y, 0), walls) + _copied(thing, left) + _copied(thing, right)
        boxes += self.boxes(12, (0.1, (0.5, 0.7, 0.5)), ((-4.5, y, 0.8), (4.5, y, 3.3)), pi)
        boxes += self.boxes(3, (0.1, 0.3), ((-0.8, y, -0.6), (0.8, y, 0.3)), pi)
        path = np.linspace(left, right, 14) * (1, 0, 0)
        centres = path + self.between((-0.5, y - 1.6, -2.9), (0.5, y - 0.8, -2.0), (14, 3))
        targets = path + self.between((-0.2, y - 0.7, 0), (0.2, y - 0.4, 0), (14, 3))
        return [(boxes, centres, targets)]

    def tower(self) -> list[_Part]:
        """A tower with four equal sides, and a path around it."""
        y = 6.0
        wide = self.between(0.9, 1.3)
        side = self.box((0, y, wide / 2), (wide - 0.01, 3, wide / 2))
        side += self.box((wide, y, wide), (0.2, 2, 0.2))
        side += self.box((0, y - 1.6, wide), self.between((0.3, 0.4, 0.1), (0.5, 0.7, 0.1)))
        boxes = self.box((0, y, 0), (14, 6, 14))
        for quarter in range(4):
            boxes += _copied(side, turn=quarter * pi / 2)
        around = self.boxes(12, ((0.1, 0.15, 0.1), (0.3, 0.45, 0.3)), ((0, y, 1.6), (0, y, 2.6)))
        around += self.boxes(14, (0.8, (1.8, 2.0, 0.8)), ((0, y, 7), (0, y, 11)))
        for box in around:
            boxes += _copied([box], turn=self.between(-pi, pi))
        turn, up, away = self.between((-0.06, 1.3, 4.6), (0.06, 2.1, 5.6), (15, 3)).T
        turn += np.linspace(0, 2 * pi, 15, endpoint=False)
        centres = np.stack([away * np.sin(turn), y - up, away * np.cos(turn)], 1)
        targets = self.between((-0.3, y - 2.1, -0.3), (0.3, y - 1.7, 0.3), (15, 3))
        return [(boxes, centres, targets)]

    def shelf(self) -> list[_Part]:
        """A shelf with five copies of the same goods, some missing in each, and a path along it."""
        period = self.between(1.8, 2.6)
        z = 2.6
        goods = list[_Box]()
        boxes = self.box((0, 2.2, 0), (9, 2.2, 3))
        x = period / 2
        for y in (-0.7, 0.1, 0.9):
            boxes += self.box((0, y + 0.06, z + 0.15), (6.5, 0.03, 0.25))
            goods += self.boxes(5, ((0.1, 0.15, 0.1), (0.2, 0.3, 0.2)), ((-x, y, z), (x, y, z)))
            boxes += self.boxes(4, ((0.08, 0.05, 0.1), (0.2, 0.1, 0.1)), ((-5, y, z), (5, y, z)))
        for place in range(-2, 3):
            left = [box for box in goods if self.rng.random() > 0.15]
            boxes += _copied(left, (place * period, 0, 0))
        path = np.linspace(-1.6, 1.6, 13)[:, None] * (period, 0, 0)
        centres = path + self.between((-0.15, -0.3, z - 1.9), (0.15, 0.4, z - 1.3), (13, 3))
        targets = path + self.between((-0.3, -0.1, z), (0.3, 0.3, z), (13, 3))
        return [(boxes, centres, targets)]


_photos = cache(load_held_back)


def folder_names(data: Path, count: int) -> list[str]:
    """The names of `count` rendered folders of each kind, and of as many posed scenes."""
    rendered = [f"{kind}_{seed}" for kind, seed in product(KINDS, range(count))]
    scenes = sorted(path.parent.name for path in data.glob("posed/*/images"))
    return rendered + thinned(scenes, len(rendered))


def _made(name: str, data: Path, out: Path) -> Folder:
    kind, _, seed = name.rpartition("_")
    if kind not in KINDS:
        frames = {frame.image.name: frame for frame in read_scene(data / "posed" / name)}
        known = {image: frames[image].camera for image in thinned([*frames], _FRAMES)}
        return data / "posed" / name / "images", known, partial(has_right_pose, frames)
    views = rendered_folder(kind, _photos(data / "photos"), int(seed))
    root = out / "folders" / name
    root.parent.mkdir(parents=True, exist_ok=True)
    if not root.is_dir():  # newer files would make the batch match their pairs again
        with replaced_folder(root) as folder:
            for image, view in views.items():
                cv2.imwrite(str(folder / image), view.image[..., ::-1])
    cameras = {image: Camera(view.camera.K[0].numpy()) for image, view in views.items()}
    return root, cameras, partial(shows_one_place, views)


def shows_one_place(views: Mapping[str, View], pair: MatchedPair) -> bool:
    """Whether at least half of the inliers lie on one surface, by the depth of either image."""
    assert pair.row.pose is not None
    ends = [views[n] for n in pair.row.names]
    matches = pair.matches.subset(pair.row.pose.inliers)
    points = (matches.points1, matches.points2)
    lands = np.zeros(len(matches), bool)
    for k, view in enumerate(ends):
        largest = np.array(view.depth.shape[::-1]) - 1
        columns, rows = np.rint(points[k]).astype(np.int64).clip(0, largest).T
        at, depth = (
            torch.from_numpy(v)[None].float() for v in (points[k], view.depth[rows, columns])
        )
        found, _ = ends[1 - k].camera.project(view.camera.unproject(at, depth))
        lands |= np.linalg.norm(found[0].numpy() - points[1 - k], axis=1) < _LANDS_PX
    return ends[0].part == ends[1].part and bool(lands.mean() >= 0.5)


def has_right_pose(frames: Mapping[str, PosedFrame], pair: MatchedPair) -> bool:
    """Whether R is right, and t too unless the cameras have almost no baseline."""
    first, second = (frames[name] for name in pair.row.names)
    pose = pair.row.pose
    assert pose is not None and pose.R is not None and first.reach and second.reach
    relative = second.cam_from_world @ np.linalg.inv(first.cam_from_world)
    R = relative[:3, :3]
    t = relative[:3, 3]
    depth = np.log([*first.reach, *second.reach]).mean()
    error = rotation_error_deg(pose.R, R)
    if pose.t is not None and np.linalg.norm(t) > _LEAST_BASELINE * np.exp(depth):
        error = max(error, translation_error_deg(pose.t, t))
    return error <= _RIGHT_DEG


def collected(name: str, data: Path, out: Path) -> dict[str, Pairs]:
    """The pairs of a folder by its name, and of every second and third photograph of a scene, as
    NAME/2 and NAME/3. Its batch and its labels are made in `out` if they are missing."""
    folder = out / "batches" / name
    labels = out / "batches" / f"{name}.npy"
    if not labels.is_file():
        root, cameras, is_right = _made(name, data, out)
        batch = run_batch(
            Source(root, tuple(cameras), None, {}),
            Calibration("the truth", cameras),
            PairChoice("exhaustive"),
            folder,
            matcher=MatcherOptions(),
            estimation=EstimationOptions(second="none"),  # whatever is installed
            options=BatchOptions(resume=True),
        )
        right_pairs = []
        for pair in batch.pairs():
            pose = pair.row.pose
            if pose is not None and pose.R is not None and is_right(pair):
                right_pairs.append(pair.row.index)
        np.save(labels, right_pairs)
    batch = read_batch(folder)
    right = np.load(labels)
    steps = () if name.rpartition("_")[0] in KINDS else _STEPS
    parts = {f"{name}/{step}": batch.plan.names[::step] for step in steps}
    every = {name: batch.plan.names, **parts}
    return {part: _pairs(batch, {*names}, right) for part, names in every.items()}


def _pairs(batch: Batch, names: set[str], right: np.ndarray) -> Pairs:
    """The pairs among images of a batch. right: indices of its right pairs."""
    among = (pair for pair in batch.pairs() if names.issuperset(pair.row.names))
    rows, placed, values = evidence_of_pairs(among, batch.plan)
    return values, np.isin([row.index for row in rows], right), *triples(placed)


def fit(folders: Mapping[str, Pairs]) -> str:
    """A table of the folders, by the names of `collected`, each judged by weights fitted on other
    scenes; and the weights fitted on all whole folders. Column "by repeats": log-odds by which
    repeats explain the folder better."""
    table = ["folder,pairs,wrong,AUC of pairs,by repeats,right rejected,wrong kept".split(",")]
    whole = {name: pairs for name, pairs in folders.items() if "/" not in name}
    for name, (values, right, found, agree) in folders.items():
        others = [pairs for other, pairs in whole.items() if other != name.partition("/")[0]]
        own = own_log_odds(values, *_weights(others))
        solved = solutions(values[:, 0], own, found, agree)
        kept = solved[has_repeats(solved, values)] > _HOLDS
        better = solved[2]
        area = roc_auc_score(right, own) if 0 < right.sum() < len(right) else np.nan
        errors = (right & ~kept).sum(), (kept & ~right).sum()
        counts = (len(right), (~right).sum(), decimals(area, 3), decimals(better, 1), *errors)
        table.append([name, *map(str, counts)])
    slopes, intercept = _weights([*whole.values()])
    fitted = f"_WEIGHTS, _INTERCEPT = np.array({slopes.round(3).tolist()}), {intercept:.3f}"
    return f"{aligned(table)}\n{fitted}"


def _weights(folders: Sequence[Pairs]) -> tuple[np.ndarray, float]:
    """Log-odds per unit of each evidence value, and the intercept."""
    values = np.concatenate([pairs[0] for pairs in folders])
    right = np.concatenate([pairs[1] for pairs in folders])
    values = np.nan_to_num(values)
    deviation = values.std(0).clip(1e-6)
    fitted = regression(1.0).fit(values / deviation, right)
    return fitted.coef_[0] / deviation, float(fitted.intercept_[0])
