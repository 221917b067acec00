"""A few matches of each pair and method, kept for the pictures of a report."""

import json
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from dgc_pose.files.inputs import read_as
from dgc_pose.matches import Matches

SAMPLE = 60  # matches of each pair and method
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


def sample_text(sample: MatchSample) -> str:
    """A sample as a cell of a table: x1, y1, x2, y2 and whether it is an inlier, of each match."""
    points = np.column_stack([sample.points1, sample.points2]).round(_DECIMALS).tolist()
    rows = [[*row, int(inlier)] for row, inlier in zip(points, sample.inliers, strict=True)]
    return json.dumps(rows, separators=(",", ":"))


def read_sample(text: str, path: Path) -> MatchSample:
    """Read what `sample_text` wrote into the table `path`. Raises InputError if it is no sample."""
    with read_as("a table with samples of matches", path):
        rows = np.array(json.loads(text), dtype=np.float64).reshape(-1, 5)
    return MatchSample(rows[:, :2], rows[:, 2:4], rows[:, 4] > 0)
