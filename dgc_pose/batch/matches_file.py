"""Matches of many pairs in one HDF5 file, in hloc's layout.

A group `name1/name2` ("/" inside a name becomes "-") holds `keypoints0`, `keypoints1` (N, 2)
float32, pixels of the images, (0, 0) the centre of the top-left pixel, `scores` (N,) float32, and
`inliers` (N,) bool, which hloc passes over.
"""

from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import dataclass, fields
from pathlib import Path
from typing import Any

import h5py
import numpy as np

from dgc_pose.errors import InputError, reason
from dgc_pose.files.arrays import ARRAY_BYTES
from dgc_pose.files.outputs import writing


@dataclass(frozen=True, eq=False)
class PairMatches:
    """The matches of one pair, pixels of the original images."""

    points1: np.ndarray  # (N, 2) float32
    points2: np.ndarray  # (N, 2) float32
    scores: np.ndarray  # (N,) float32, confidence in [0, 1]
    inliers: np.ndarray  # (N,) bool, of the pose


_NO_POINTS = np.zeros((0, 2), np.float32)
NO_MATCHES = PairMatches(_NO_POINTS, _NO_POINTS, _NO_POINTS[:, 0], np.zeros(0, bool))
_FIELDS = [field.name for field in fields(PairMatches)]
_DATASETS = dict(zip(("keypoints0", "keypoints1", "scores", "inliers"), _FIELDS, strict=True))


def group_name(name1: str, name2: str) -> str:
    """The group of a pair in hloc's layout."""
    return "/".join(name.replace("/", "-") for name in (name1, name2))


def write_matches(group: h5py.Group, matches: PairMatches) -> None:
    """The matches of a pair, as datasets of its group."""
    for dataset, field in _DATASETS.items():
        group.create_dataset(dataset, data=getattr(matches, field))


@contextmanager
def new_file(path: Path) -> Iterator[Any]:
    """An HDF5 file that is made in memory and written at once: HDF5 cannot bear a full disk."""
    with h5py.File(path.name, "w", driver="core", backing_store=False) as file:
        yield file
        file.flush()
        image = file.id.get_file_image()
    with writing(path):
        path.write_bytes(image)


@contextmanager
def open_matches(path: Path) -> Iterator[Any]:
    """An HDF5 file to read. Raises InputError, with the path, if it is missing, cut short or of
    another kind."""
    if not path.is_file():
        raise InputError(f"{path}: no such file")
    try:
        file = h5py.File(path, "r")
    except Exception as error:
        raise InputError(f"{path}: not an HDF5 file that can be read ({reason(error)})") from None
    with file:
        yield file


def read_matches(file: Any, name: str) -> PairMatches:
    """The matches of the group `name` of an open file. Raises InputError, with the path, if there
    are none, or if they are not whole.

    Links to other files and places are not followed: they could lead anywhere.
    """
    where = f"{file.filename}: {name}"
    try:
        group = file
        for part in name.split("/"):
            group = _member(group, part, h5py.Group)
        arrays = {field: _array(group, dataset) for dataset, field in _DATASETS.items()}
    except Exception:  # of HDF5, for damaged files almost any
        raise InputError(f"{where}: no whole matches") from None
    count = len(arrays["scores"])
    shapes = [arrays[name].shape for name in _DATASETS.values()]
    if shapes != [(count, 2), (count, 2), (count,), (count,)]:
        raise InputError(f"{where}: datasets of different lengths")
    if not all(np.isfinite(array).all() for array in arrays.values()):
        raise InputError(f"{where}: numbers that are not finite")
    return PairMatches(**arrays)


def _member(group: Any, name: str, kind: type) -> Any:
    if not isinstance(group.get(name, getlink=True), h5py.HardLink):
        raise ValueError("a link, or nothing")
    if not isinstance(group[name], kind):
        raise ValueError("something else")
    return group[name]


def _array(group: Any, name: str) -> np.ndarray:
    """A data set of numbers of this file itself, not too large; raises anything else."""
    data = _member(group, name, h5py.Dataset)
    kind = "b" if name == "inliers" else "f"
    if data.external or data.is_virtual or data.dtype.kind != kind or data.nbytes > ARRAY_BYTES:
        raise ValueError("not numbers of this file")
    return np.asarray(data[()])
