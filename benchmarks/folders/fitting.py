"""The fit of `batch/look_alikes.py`: what of a pair by itself speaks for it.

Folders with repeats are rendered, ordinary ones are posed photographs; their pairs are matched.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Mapping, Sequence
from functools import cache, partial
from itertools import product
from pathlib import Path

import cv2
import numpy as np
import torch
from sklearn.metrics import roc_auc_score

from dgc_pose.batch.look_alikes import (
    by_itself,
    evidence_of_pairs,
    shows_repeats,
    solutions,
    triples,
)
from dgc_pose.batch.options import BatchOptions
from dgc_pose.batch.pairs import LEAST_BELIEF, MatchedPair
from dgc_pose.batch.result import read_batch
from dgc_pose.batch.run import run_batch
from dgc_pose.batch.source import PairChoice, Source
from dgc_pose.benchmarks.folders.rendered import KINDS, View, rendered_folder
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
from dgc_pose.training.photos import load_held_back
from dgc_pose.training.posed_frames import PosedFrame, read_scene

_HOLDS = math.log(LEAST_BELIEF / (1 - LEAST_BELIEF))
_FRAMES = 13  # of a posed scene, evenly spread
_LANDS_PX = 8.0  # of an inlier from where the truth has it
_RIGHT_DEG, _LEAST_BASELINE = 10.0, 0.1  # the latter over the depth, of a t that counts
# Folder of images, their cameras by name, and whether a pair that has a pose is right
Folder = tuple[Path, Mapping[str, Camera], Callable[[MatchedPair], bool]]


# Of the pairs that have a pose the values (n, 3) of `evidence_of_pairs`, whether they are right,
# (n,), their triples (M, 3), and whether these agree, (M,)
Pairs = tuple[np.ndarray, np.ndarray, np.ndarray, np.ndarray]
_photos = cache(load_held_back)


def folder_names(data: Path, count: int) -> list[str]:
    """The names of so many rendered folders of each kind, and of as many posed scenes."""
    rendered = [f"{kind}_{seed}" for kind, seed in product(KINDS, range(count))]
    scenes = sorted(path.parent.name for path in data.glob("posed/*/images"))
    return rendered + thinned(scenes, len(rendered))


def _made(name: str, data: Path, out: Path) -> Folder:
    kind, _, seed = name.rpartition("_")
    if kind not in KINDS:
        frames = {frame.image.name: frame for frame in read_scene(data / "posed" / name)}
        of_frames = {image: frames[image].camera for image in thinned([*frames], _FRAMES)}
        return data / "posed" / name / "images", of_frames, partial(has_right_pose, frames)
    views, root = rendered_folder(kind, _photos(data / "photos"), int(seed)), out / "folders" / name
    root.parent.mkdir(parents=True, exist_ok=True)
    if not root.is_dir():  # else the pairs of newer files are matched again
        with replaced_folder(root) as folder:
            for image, view in views.items():
                cv2.imwrite(str(folder / image), view.image[..., ::-1])
    cameras = {image: Camera(view.camera.K[0].numpy()) for image, view in views.items()}
    return root, cameras, partial(shows_one_place, views)


def shows_one_place(views: Mapping[str, View], pair: MatchedPair) -> bool:
    """Whether half of the inliers or more are on one surface, by the depth of either image."""
    assert pair.row.pose is not None
    ends, matches = [views[n] for n in pair.row.names], pair.matches.subset(pair.row.pose.inliers)
    points, lands = (matches.points1, matches.points2), np.zeros(len(matches), bool)
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
    """Whether R is right, and t unless the cameras are at one place."""
    (first, second), pose = (frames[name] for name in pair.row.names), pair.row.pose
    assert pose is not None and pose.R is not None and first.reach and second.reach
    relative = second.cam_from_world @ np.linalg.inv(first.cam_from_world)
    R, t, depth = relative[:3, :3], relative[:3, 3], np.log([*first.reach, *second.reach]).mean()
    error = rotation_error_deg(pose.R, R)
    if pose.t is not None and np.linalg.norm(t) > _LEAST_BASELINE * np.exp(depth):
        error = max(error, translation_error_deg(pose.t, t))
    return error <= _RIGHT_DEG


def collected(name: str, data: Path, out: Path) -> Pairs:
    """The pairs of a folder, whose batch and labels are made in `out` unless they are there."""
    folder, labels = out / "batches" / name, out / "batches" / f"{name}.npy"
    if not labels.is_file():
        root, cameras, is_right = _made(name, data, out)
        batch = run_batch(
            Source(root, tuple(cameras), None, {}),
            Calibration("the truth", cameras),
            PairChoice("exhaustive"),
            folder,
            matcher=MatcherOptions(),
            estimation=EstimationOptions(),
            options=BatchOptions(resume=True),
        )
        posed = (pair for pair in batch.pairs() if pair.row.pose and pair.row.pose.R is not None)
        np.save(labels, [pair.row.index for pair in posed if is_right(pair)])
    batch = read_batch(folder)
    rows, relations, values = evidence_of_pairs(batch.pairs(), batch.plan)
    right = np.isin([row.index for row in rows], np.load(labels))
    return values, right, *triples(relations)


def fit(folders: Mapping[str, Pairs]) -> str:
    """A table of the folders, each by weights of the others, with how much better repeats explain a
    pair of it; and the weights of all."""
    table = ["folder,pairs,wrong,AUC alone,by repeats,right turned down,wrong kept".split(",")]
    for name, (values, right, found, agree) in folders.items():
        alone = by_itself(values, *_weights([of for other, of in folders.items() if other != name]))
        solved = solutions(values[:, 0], alone, found, agree)
        kept, better = solved[shows_repeats(solved, values)] > _HOLDS, solved[2]
        area = roc_auc_score(right, alone) if 0 < right.sum() < len(right) else np.nan
        errors = (right & ~kept).sum(), (kept & ~right).sum()
        counts = (
            len(right),
            (~right).sum(),
            decimals(area, 3),
            decimals(better / len(right), 2),
            *errors,
        )
        table.append([name, *map(str, counts)])
    weights, intercept = _weights([*folders.values()])
    fitted = f"_WEIGHTS, _INTERCEPT = np.array({weights.round(3).tolist()}), {intercept:.3f}"
    return f"{aligned(table)}\n{fitted}"


def _weights(folders: Sequence[Pairs]) -> tuple[np.ndarray, float]:
    """Log-odds for a unit of each value, and the intercept."""
    values, right = (np.concatenate([of[k] for of in folders]) for k in range(2))
    values = np.nan_to_num(values)
    deviation = values.std(0).clip(1e-6)
    fitted = regression(1.0).fit(values / deviation, right)
    return fitted.coef_[0] / deviation, float(fitted.intercept_[0])
