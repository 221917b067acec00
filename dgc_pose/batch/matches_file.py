"""Matches of many pairs in one HDF5 file, in hloc's layout.

A group `name1/name2` ("/" inside a name becomes "-") holds `keypoints0`, `keypoints1` (N, 2)
float32, pixels of the images, (0, 0) the centre of the top-left pixel, `scores` (N,) float32, and
`inliers` (N,) bool, which hloc passes over.
"""

from collections.abc import Iterable, Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import Any

import h5py
import numpy as np

from dgc_pose.batch.rows import MatchedPair
from dgc_pose.files.outputs import writing


def group_name(name1: str, name2: str) -> str:
    """The group of a pair in hloc's layout."""
    return "/".join(name.replace("/", "-") for name in (name1, name2))


def write_matches(path: Path, pairs: Iterable[MatchedPair]) -> None:
    """Write the matches of pairs."""
    with h5py.File(path, "w") as file:
        for pair in pairs:
            group, matches, pose = group_name(*pair.row.names), pair.matches, pair.row.pose
            file[f"{group}/keypoints0"] = matches.points1.astype(np.float32)
            file[f"{group}/keypoints1"] = matches.points2.astype(np.float32)
            file[f"{group}/scores"] = matches.confidence.astype(np.float32)
            file[f"{group}/inliers"] = np.zeros(0, bool) if pose is None else pose.inliers


@contextmanager
def new_file(path: Path) -> Iterator[Any]:
    """An HDF5 file that is made in memory and written at once: HDF5 cannot bear a full disk."""
    with h5py.File(path.name, "w", driver="core", backing_store=False) as file:
        yield file
        file.flush()
        image = file.id.get_file_image()
    with writing(path):
        path.write_bytes(image)
