"""A few matches of each pair and method, kept for the pictures of a report."""

from __future__ import annotations

import hashlib
import json
from dataclasses import dataclass
from pathlib import Path
from urllib.parse import quote

import numpy as np

from dgc_pose.benchmarks.scores import Key
from dgc_pose.errors import InputError
from dgc_pose.files.json_files import read_json
from dgc_pose.files.outputs import save_text
from dgc_pose.matches import Matches

FOLDER = "matches"
SAMPLE = 60  # matches of each pair and method
_LONGEST_NAME = 120  # of a method in a file name; file systems end at 255 bytes
_DECIMALS = 2  # of a pixel


@dataclass(frozen=True, eq=False)
class MatchSample:
    """Matches in pixels of the images that the methods saw. Raises InputError if the shapes
    disagree or a coordinate is not finite."""

    points1: np.ndarray  # (N, 2) float64
    points2: np.ndarray  # (N, 2) float64
    inliers: np.ndarray  # (N,) bool: whether the estimated pose agrees

    def __post_init__(self) -> None:
        for name in ("points1", "points2"):
            points = np.asarray(getattr(self, name), dtype=np.float64).reshape(-1, 2)
            if not np.isfinite(points).all():
                raise InputError(f"{name} of a sample must be finite")
            object.__setattr__(self, name, points)
        inliers = np.asarray(self.inliers)
        if inliers.dtype != bool and len(inliers):
            raise InputError("inliers of a sample must be true or false")
        object.__setattr__(self, "inliers", inliers.astype(bool))
        if not self.points1.shape == self.points2.shape == (*self.inliers.shape, 2):
            raise InputError("points1, points2 and inliers of a sample must have the same length")

    def __len__(self) -> int:
        return len(self.points1)


def draw_sample(matches: Matches, inliers: np.ndarray, seed: int) -> MatchSample:
    """At most `SAMPLE` of the finite matches at random; inliers: (N,) bool."""
    finite = np.isfinite(matches.points1).all(1) & np.isfinite(matches.points2).all(1)
    shuffled = np.random.default_rng(seed).permutation(np.flatnonzero(finite))
    chosen = np.sort(shuffled[:SAMPLE])
    return MatchSample(matches.points1[chosen], matches.points2[chosen], inliers[chosen])


def write_sample(out: Path, key: Key, sample: MatchSample) -> None:
    """Write the sample of a record, by its key, into the folder of a run."""
    path = sample_path(out, key)
    path.parent.mkdir(exist_ok=True)
    record = {
        "points1": sample.points1.round(_DECIMALS).tolist(),
        "points2": sample.points2.round(_DECIMALS).tolist(),
        "inliers": sample.inliers.tolist(),
    }
    save_text(path, json.dumps(record) + "\n")


def read_sample(out: Path, key: Key) -> MatchSample:
    """Read what `write_sample` wrote. Raises InputError with the path if it is no sample, OSError
    if it cannot be read."""
    path = sample_path(out, key)
    record = read_json(path, "a sample of matches")
    try:
        return MatchSample(record["points1"], record["points2"], record["inliers"])
    except InputError as error:
        raise InputError(f"{path}: {error}") from None
    except (ValueError, KeyError, TypeError, OverflowError):
        raise InputError(f"{path}: not a sample of matches") from None


def sample_path(out: Path, key: Key) -> Path:
    """`matches/SCENE_VIEW1_VIEW2_METHOD.json` within the folder of a run."""
    method, *pair = key
    return out / FOLDER / f"{'_'.join(map(str, pair))}_{method_file_name(method)}.json"


def method_file_name(method: str) -> str:
    """A method's name as part of a file name: `/` and the like as %2F, paths of any length, and
    no two methods alike."""
    name = quote(method, safe="")
    if len(name) <= _LONGEST_NAME:
        return name
    # Longer by one than any short name, so that no two agree.
    return name[: _LONGEST_NAME - 16] + "~" + hashlib.sha256(method.encode()).hexdigest()[:16]
