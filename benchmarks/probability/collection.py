"""Matches of planned pairs, stored, so that evidence and model are fitted again without matching.

One file a pair and method: OUT/matches/METHOD/SOURCE/NUMBER.npz, with the matches, an even sample
of the dense map, both cameras, and the true pose. A file that is there is not made again, so that a
collection goes on after any kill. `engine.json` of a method's folder has the weights' fingerprint;
a collection with other weights is refused.
"""

from __future__ import annotations

import json
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from dgc_pose.benchmarks.posed_pairs import PosedPair, Truth
from dgc_pose.benchmarks.probability.plan import Part, Source
from dgc_pose.benchmarks.probability.sources import PlannedPair
from dgc_pose.cameras.camera import Camera
from dgc_pose.errors import InputError
from dgc_pose.files.arrays import read_arrays
from dgc_pose.files.inputs import read_as
from dgc_pose.files.json_files import read_json
from dgc_pose.files.outputs import replaced, write_text, writing
from dgc_pose.matches import Matches
from dgc_pose.matching import Matcher, MatchResult

_ENGINE = "engine.json"


@dataclass(frozen=True, eq=False)
class StoredPair:
    """What was found in a pair, and the truth."""

    name: str  # unique within a method
    scene: str
    part: Part
    exact: bool  # the true pose is: see `Source.rough`
    truth: Truth
    matches: Matches
    map_matches: Matches | None  # an even sample of the dense map, whatever its matchability


def store_path(out: Path, method: str, source: Source, number: int) -> Path:
    """The file of a pair."""
    return out / "matches" / method / source.name / f"{number:04d}.npz"


def require_engine(out: Path, method: str, matcher: Matcher) -> None:
    """Begin a collection of a method, or see that it was begun with the same weights.

    Raises InputError if it was not.
    """
    path = out / "matches" / method / _ENGINE
    own = {"name": matcher.name, "fingerprint": matcher.fingerprint}
    if not path.is_file():
        path.parent.mkdir(parents=True, exist_ok=True)
        write_text(path, json.dumps(own) + "\n")
    elif read_engine(out, method) != own:
        raise InputError(f"{path}: collected with other weights than those of {matcher.name}")


def read_engine(out: Path, method: str) -> dict[str, str | None]:
    """Name and fingerprint of what a collection was matched with. Raises InputError without."""
    path = out / "matches" / method / _ENGINE
    if not path.is_file():
        raise InputError(f"{path}: nothing is collected for {method}")
    engine = read_json(path, "what a collection was matched with")
    if not isinstance(engine, dict):
        raise InputError(f"{path}: not what a collection was matched with")
    return engine


def collect(
    pairs: Sequence[PlannedPair], matchers: dict[str, Matcher], out: Path
) -> Iterator[PlannedPair]:
    """Match the pairs that are not stored yet; yields each pair that is done.

    Raises what reading a pair raises.
    """
    for pair in pairs:
        wanted = {
            name: path
            for name in matchers
            if not (path := store_path(out, name, pair.source, pair.number)).is_file()
        }
        if wanted:
            made = pair.make()
            for name, path in wanted.items():
                found = matchers[name].match(made.image1, made.image2)
                path.parent.mkdir(parents=True, exist_ok=True)
                _write(path, pair, made, found)
        yield pair


def read_collection(out: Path, method: str, sources: Sequence[Source]) -> Iterator[StoredPair]:
    """All stored pairs of a method, source by source."""
    for source in sources:
        for path in sorted((out / "matches" / method / source.name).glob("*.npz")):
            yield _read(path, source)


def _write(path: Path, pair: PlannedPair, made: PosedPair, found: MatchResult) -> None:
    truth = made.truth
    arrays: dict[str, object] = {"scene": pair.scene}
    for number, camera, image in ((1, truth.camera1, made.image1), (2, truth.camera2, made.image2)):
        arrays |= {f"K{number}": camera.K, f"size{number}": image.size}
    if truth.R is not None:
        arrays["R"] = truth.R
    if truth.t is not None:
        arrays["t"] = truth.t
    arrays |= _arrays("", found.matches)
    if found.map_matches is not None:
        arrays |= _arrays("map_", found.map_matches)
    with replaced(path) as stage, writing(stage), stage.open("wb") as stream:
        np.savez_compressed(stream, **arrays)  # type: ignore[arg-type]


def _read(path: Path, source: Source) -> StoredPair:
    arrays = read_arrays(path)
    with read_as("a stored pair", path):
        return _stored(path, source, arrays)


def _stored(path: Path, source: Source, arrays: Mapping[str, np.ndarray]) -> StoredPair:
    camera1, camera2 = (
        Camera(arrays[f"K{n}"], (int(arrays[f"size{n}"][0]), int(arrays[f"size{n}"][1])))
        for n in (1, 2)
    )
    name, scene = f"{source.name} {path.stem}", str(arrays["scene"])
    truth = Truth({"name": name}, camera1, camera2, arrays.get("R"), arrays.get("t"))
    return StoredPair(
        name,
        scene,
        source.part,
        scene not in source.rough,
        truth,
        _matches("", arrays),
        _matches("map_", arrays) if "map_points1" in arrays else None,
    )


def _arrays(prefix: str, matches: Matches) -> dict[str, object]:
    return {
        # Both sides are in pixels: a float32 keeps a thousandth of one.
        f"{prefix}points1": matches.points1.astype(np.float32),
        f"{prefix}points2": matches.points2.astype(np.float32),
        f"{prefix}confidence": matches.confidence.astype(np.float32),
        f"{prefix}error_px": matches.error_px,
        f"{prefix}key_points": matches.key_points,
    }


def _matches(prefix: str, arrays: Mapping[str, np.ndarray]) -> Matches:
    return Matches(
        arrays[f"{prefix}points1"],
        arrays[f"{prefix}points2"],
        arrays[f"{prefix}confidence"],
        float(arrays[f"{prefix}error_px"]),
        bool(arrays[f"{prefix}key_points"]),
    )
