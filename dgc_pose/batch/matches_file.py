"""Matches of many pairs in one HDF5 file, in hloc's layout.

A group `name1/name2` ("/" inside a name becomes "-") holds `keypoints0`, `keypoints1` (N, 2)
float32, pixels of the images, (0, 0) the centre of the top-left pixel, `scores` (N,) float32, and
`inliers` (N,) bool, which hloc passes over.
"""

from __future__ import annotations

from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import h5py
import numpy as np

from dgc_pose.errors import InputError


@dataclass(frozen=True, eq=False)
class PairMatches:
    """The matches of one pair, pixels of the original images."""

    points1: np.ndarray  # (N, 2) float32
    points2: np.ndarray  # (N, 2) float32
    scores: np.ndarray  # (N,) float32, confidence in [0, 1]
    inliers: np.ndarray  # (N,) bool, of the pose


NO_MATCHES = PairMatches(
    np.zeros((0, 2), np.float32),
    np.zeros((0, 2), np.float32),
    np.zeros(0, np.float32),
    np.zeros(0, bool),
)
_DATASETS = {
    "keypoints0": "points1",
    "keypoints1": "points2",
    "scores": "scores",
    "inliers": "inliers",
}


def group_name(name1: str, name2: str) -> str:
    """The group of a pair in hloc's layout."""
    return "/".join(name.replace("/", "-") for name in (name1, name2))


def write_matches(group: h5py.Group, matches: PairMatches) -> None:
    """The matches of a pair, as datasets of its group."""
    for dataset, field in _DATASETS.items():
        group.create_dataset(dataset, data=getattr(matches, field))


def read_matches(group: h5py.Group) -> PairMatches:
    """The matches of a group. Raises InputError if they are none."""
    try:
        arrays = {field: np.asarray(group[name]) for name, field in _DATASETS.items()}
    except (KeyError, OSError) as error:
        raise InputError(f"{group.file.filename}: {group.name}: no whole matches") from error
    if not arrays["points1"].shape == arrays["points2"].shape == (len(arrays["scores"]), 2):
        raise InputError(f"{group.file.filename}: {group.name}: datasets of different lengths")
    return PairMatches(**arrays)


@contextmanager
def open_matches(path: Path) -> Iterator[Any]:
    """An HDF5 file to read. Raises InputError, with the path, if it is missing, cut short or of
    another kind."""
    if not path.is_file():
        raise InputError(f"{path}: no such file")
    try:
        file = h5py.File(path, "r")
    except OSError as error:
        raise InputError(f"{path}: cut short, or no HDF5 file ({_line(error)})") from None
    with file:
        yield file


def _line(error: Exception) -> str:
    return str(error).splitlines()[0] if str(error) else type(error).__name__
