"""Matches of planned pairs, stored, so that evidence and model are fitted again without matching.

One file a pair and method: OUT/matches/METHOD/ENTRY/NUMBER.npz, with the matches, an even sample
of the dense map, both cameras, and the true pose. A file that is there is not made again, so that a
collection goes on after any kill. `engine.json` of a method's folder has the weights' fingerprint;
a collection with other weights is refused.
"""

from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np

from dgc_pose.benchmarks.posed_pairs import Truth
from dgc_pose.benchmarks.probability.plan import PlanEntry
from dgc_pose.benchmarks.probability.planned import PlannedPair
from dgc_pose.cameras.camera import Camera
from dgc_pose.cameras.lines import focal_scores
from dgc_pose.errors import InputError
from dgc_pose.estimation import EstimationOptions
from dgc_pose.matches import Matches
from dgc_pose.matching import Matcher
from dgc_pose.pose import solve_pair
from dgc_pose.system.arrays import read_arrays
from dgc_pose.system.files import naming_path, read_as, replaced
from dgc_pose.system.texts import read_json, write_json

_ENGINE = "engine.json"
_THOROUGH = EstimationOptions(effort="thorough")
_FIELDS = ("points1", "points2", "confidence", "error_px", "key_points")  # of Matches


@dataclass(frozen=True, eq=False)
class StoredPair:
    """What a method matched in a pair, and the truth."""

    entry: PlanEntry
    name: str  # unique within a method
    scene: str
    truth: Truth
    matches: Matches
    # With those searched again; None if the pose by the true K is not in doubt.
    pooled: Matches | None
    map_matches: Matches | None  # an even sample of the dense map, whatever its matchability
    scores: tuple[tuple[np.ndarray, int], tuple[np.ndarray, int]]  # `focal_scores` of each image


def store_path(out: Path, method: str, entry: PlanEntry, number: int) -> Path:
    """The file of a pair."""
    return out / "matches" / method / entry.name / f"{number:04d}.npz"


def require_engine(out: Path, method: str, matcher: Matcher) -> None:
    """Begin a collection of a method, or see that it was begun with the same weights.

    Raises InputError if it was not.
    """
    path = out / "matches" / method / _ENGINE
    engine = {"name": matcher.name, "fingerprint": matcher.fingerprint}
    if not path.is_file():
        path.parent.mkdir(parents=True, exist_ok=True)
        write_json(path, engine)
    elif read_engine(out, method) != engine:
        raise InputError(f"{path}: collected with other weights than those of {matcher.name}")


def read_engine(out: Path, method: str) -> Any:
    """Name and fingerprint of what a collection was matched with. Raises InputError without."""
    path = out / "matches" / method / _ENGINE
    if not path.is_file():
        raise InputError(f"{path}: nothing is collected for {method}")
    return read_json(path, "what a collection was matched with")


def collect(pair: PlannedPair, matchers: Mapping[str, Matcher], out: Path) -> None:
    """Match a pair by the methods of which it is not stored yet, and write its matches, with those
    searched again if its pose is in doubt.

    Raises what reading a pair raises.
    """
    paths = {name: store_path(out, name, pair.entry, pair.number) for name in matchers}
    missing = {name: path for name, path in paths.items() if not path.is_file()}
    if not missing:
        return
    posed = pair.make()
    images, truth = (posed.image1, posed.image2), posed.truth
    cameras = truth.camera1, truth.camera2
    known: dict[str, object] = {"scene": pair.scene}
    for n, image, camera in zip("12", images, cameras, strict=True):
        known |= {"K" + n: camera.K, "size" + n: image.size}
        known["scores" + n], known["segments" + n] = focal_scores(image)
    if truth.R is not None:
        known |= {"R": truth.R, "t": truth.t}
    for name, path in missing.items():
        result = matchers[name].match(*images)
        arrays = known | _arrays("", result.matches)
        if matchers[name].engine is not None:
            pooled = solve_pair(*images, cameras, matchers[name], _THOROUGH).matches
            if not np.array_equal(pooled.points1, result.matches.points1):
                arrays |= _arrays("pooled_", pooled)
        if result.map_matches is not None:
            arrays |= _arrays("map_", result.map_matches)
        path.parent.mkdir(parents=True, exist_ok=True)
        with replaced(path) as stage, naming_path(stage), stage.open("wb") as stream:
            np.savez_compressed(stream, **arrays)  # type: ignore[arg-type]


def read_collection(out: Path, method: str, entries: Sequence[PlanEntry]) -> Iterator[StoredPair]:
    """All stored pairs of a method, entry by entry."""
    weights = read_engine(out, method)["fingerprint"]
    for entry in entries:
        for path in sorted((out / "matches" / method / entry.name).glob("*.npz")):
            arrays = read_arrays(path)
            with read_as("a stored pair", path):
                camera1, camera2 = (
                    Camera(arrays["K" + n], tuple(arrays["size" + n].tolist())) for n in "12"
                )
                stored = StoredPair(
                    entry,
                    f"{entry.name} {path.stem}",
                    str(arrays["scene"]),
                    Truth({}, camera1, camera2, arrays.get("R"), arrays.get("t")),
                    _matches("", arrays, weights),
                    _matches("pooled_", arrays, weights) if "pooled_points1" in arrays else None,
                    _matches("map_", arrays, weights) if "map_points1" in arrays else None,
                    (
                        (arrays["scores1"], int(arrays["segments1"])),
                        (arrays["scores2"], int(arrays["segments2"])),
                    ),
                )
            yield stored


def _arrays(prefix: str, matches: Matches) -> dict[str, object]:
    # Both sides are in pixels: a float32 keeps a thousandth of one.
    values = {name: getattr(matches, name) for name in _FIELDS}
    values |= {name: values[name].astype(np.float32) for name in _FIELDS[:3]}
    if matches.surroundings is not None:
        values["surroundings"] = matches.surroundings
    return {prefix + name: value for name, value in values.items()}


def _matches(prefix: str, arrays: Mapping[str, np.ndarray], weights: str | None) -> Matches:
    points1, points2, confidence, error_px, key_points = (arrays[prefix + n] for n in _FIELDS)
    around = arrays.get(prefix + "surroundings")
    return Matches(
        *(points1, points2, confidence, float(error_px), bool(key_points), weights),
        surroundings=None if around is None else float(around),
    )
