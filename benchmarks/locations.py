"""Queries of known poses left out of a model, and placed in it."""

from __future__ import annotations

import time
from collections.abc import Sequence
from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np

from dgc_pose.benchmarks.camera_trial import WithheldCameras
from dgc_pose.benchmarks.reconstructions import views_of_list
from dgc_pose.images.decoding import image_size
from dgc_pose.localization.locate import Locator
from dgc_pose.metrics import rotation_error_deg
from dgc_pose.model import Model, load_model
from dgc_pose.training.posed_frames import read_rgbd

_CLAIMS = (0.5, 0.9, 0.99)  # probabilities of which the precision is reported


@dataclass(frozen=True)
class LocationScore:
    """A query that was placed, compared with its true pose."""

    name: str
    status: str
    probability: float
    database_images: int  # that were matched
    seconds: float
    pair_seconds: float  # of these, of the pairs
    # NaN unless it is located
    rotation_deg: float = np.nan
    position: float = np.nan  # the model's unit
    position_percent: float = np.nan  # of the extent
    rotation_error_90_deg: float = np.nan  # expected
    position_error_90: float = np.nan
    focal_percent: float = np.nan  # error of the focal length

    @property
    def is_right(self) -> bool:
        """Whether R is within 5 degrees, and the position within 5 % of the extent."""
        return self.rotation_deg < 5 and self.position_percent < 5


def true_model(path: Path, images: Path | None) -> Model:
    """A model as of `load_model`; of a list of pairs in SuperGlue's format; or of a folder of posed
    RGB-D, see `read_rgbd`.

    images: of a list by default the folder of its name; of a model images/ beside or in it.
    """
    if path.is_file() and path.suffix == ".txt":
        return views_of_list(path, images or path.parent / path.stem.removesuffix("_pairs"))
    if (path / "poses.txt").is_file():
        frames = {frame.image.name: frame for frame in read_rgbd(path)}
        cameras = {n: replace(f.camera, size=image_size(f.image)) for n, f in frames.items()}
        poses = {name: frame.cam_from_world[:3] for name, frame in frames.items()}
        return Model(path / "images", cameras, poses)
    return load_model(path, images or path / "images")


def thinned(items: Sequence[str], count: int | None) -> list[str]:
    """So many of the items, evenly chosen; all without a number."""
    most = len(items) if count is None else min(count, len(items))
    return [items[int(i)] for i in np.linspace(0, len(items) - 1, most)]


def placed(
    locator: Locator, name: str, apart: int, withheld: WithheldCameras | None
) -> LocationScore:
    """The score of an image of the model as a query, without those near it in their order."""
    model, start = locator.model, time.perf_counter()
    camera, names = model.cameras[name], sorted(model.poses)
    number = names.index(name)
    out = names[max(0, number - apart + 1) : number + apart]
    location = locator.locate(model.root / name, withheld or camera, left_out=out)
    seconds = time.perf_counter() - start
    likely = np.nan if location.probability is None else location.probability
    common = (name, location.status, likely, len(location.database_images), seconds)
    of_pairs = location.seconds["match"]
    if location.R is None or location.centre is None or location.camera is None:
        return LocationScore(*common, of_pairs)
    position = float(np.linalg.norm(location.centre - model.centre(name)))
    return LocationScore(
        *common,
        of_pairs,
        rotation_error_deg(location.R, model.poses[name][:, :3]),
        position,
        100 * position / model.extent,
        location.rotation_error_90_deg or np.nan,
        location.position_error_90 or np.nan,
        100 * abs(location.camera.focal / camera.focal - 1),
    )


def report(scores: Sequence[LocationScore]) -> list[tuple[str, str]]:
    """What is measured, and its figures."""
    located = [score for score in scores if score.status == "located"]
    counted = {
        "located": [score.status == "located" for score in scores],
        "right: within 5 deg and 5 % of the extent": [score.is_right for score in scores],
        "within 2 deg and 0.05 of the unit": [
            score.rotation_deg < 2 and score.position < 0.05 for score in scores
        ],
        **{
            f"right of those at {least:g} or more": [
                score.is_right for score in scores if score.probability >= least
            ]
            for least in _CLAIMS
        },
        "R within its expected error": [
            score.rotation_deg < score.rotation_error_90_deg for score in located
        ],
        "position within its expected error": [
            score.position < score.position_error_90 for score in located
        ],
    }
    medians = {
        "R, median, deg": [score.rotation_deg for score in located],
        "position, median, % of the extent": [score.position_percent for score in located],
        "position, median, unit": [score.position for score in located],
        "f off, median, %": [score.focal_percent for score in located],
        "database images, median": [float(score.database_images) for score in scores],
        "seconds, median": [score.seconds for score in scores],
        "seconds over those of the pairs, median": [
            score.seconds / score.pair_seconds for score in scores if score.pair_seconds
        ],
    }
    lines = [(name, f"{sum(flags)} of {len(flags)}") for name, flags in counted.items()]
    return lines + [(name, f"{np.median(v):.3g}" if v else "-") for name, v in medians.items()]
