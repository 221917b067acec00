"""A few matches of each pair and method, kept for the pictures of a report."""

import hashlib
import json
from dataclasses import dataclass
from pathlib import Path
from urllib.parse import quote

import numpy as np

from dgc_pose.benchmarks.scores import Key
from dgc_pose.files.inputs import read_as
from dgc_pose.files.json_files import read_json
from dgc_pose.files.outputs import save_text
from dgc_pose.matches import Matches

FOLDER = "matches"
SAMPLE = 60  # matches of each pair and method
_LONGEST_NAME = 120  # of a method in a file name; file systems end at 255 bytes
_DECIMALS = 2  # of a pixel


@dataclass(frozen=True, eq=False)
class MatchSample:
    """Matches in pixels of the images that the methods saw."""

    points1: np.ndarray  # (N, 2) float64
    points2: np.ndarray  # (N, 2) float64
    inliers: np.ndarray  # (N,) bool: whether the estimated pose agrees

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
    path, what = sample_path(out, key), "a sample of matches"
    record = read_json(path, what)
    with read_as(what, path):
        count = len(record["inliers"])
        points1, points2 = (
            np.array(record[side], dtype=np.float64).reshape(count, 2)
            for side in ("points1", "points2")
        )
        return MatchSample(points1, points2, np.array(record["inliers"], dtype=bool))


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
