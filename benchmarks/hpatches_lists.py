"""The DGC-Net authors' lists of HPatches pairs, hpatches_1_2.csv to hpatches_1_6.csv.

A line is `obj,im1,im2,Him,Wim,H11,...,H33`: the images <root>/<obj>/<k>.ppm, height and width of
image 1, and the homography from im1 to im2 at full size.
"""

from __future__ import annotations

import csv
import io
from pathlib import Path

import numpy as np

from dgc_pose.benchmarks.homographies import (
    VIEWPOINTS,
    HomographyPair,
    HomographySet,
    check_matrix,
)
from dgc_pose.errors import InputError
from dgc_pose.files.inputs import read_as, read_text

_MATRIX = [f"H{row}{column}" for row in (1, 2, 3) for column in (1, 2, 3)]
_COLUMNS = ["obj", "im1", "im2", "Him", "Wim", *_MATRIX]


def read_lists(folder: str | Path, root: str | Path) -> HomographySet:
    """The pairs of all five lists; those whose images are not below `root` are `missing`.

    Raises InputError, with the path and the line, if a list is missing or a line malformed.
    """
    pairs: list[HomographyPair] = []
    missing: list[str] = []
    for k, viewpoint in enumerate(VIEWPOINTS, start=2):
        path = Path(folder) / f"hpatches_1_{k}.csv"
        if not path.is_file():
            raise InputError(f"{path}: no such list; there are five, hpatches_1_2 to hpatches_1_6")
        for pair in _read(path, Path(root), viewpoint):
            if pair.path1.is_file() and pair.path2.is_file():
                pairs.append(pair)
            else:
                missing.append(pair.name)
    if not pairs:
        raise InputError(f"{root}: holds no image of the {len(missing)} pairs listed in {folder}")
    return HomographySet(tuple(pairs), tuple(missing))


def _read(path: Path, root: Path, viewpoint: str) -> list[HomographyPair]:
    text = io.StringIO(read_text(path, "a list of pairs"), newline="")
    with read_as("a list of pairs", path):
        reader = csv.DictReader(text)
        absent = [name for name in _COLUMNS if name not in (reader.fieldnames or ())]
        if absent:
            raise InputError(f"{path}:1: the columns {', '.join(absent)} are lacking")
        return [_parse(row, f"{path}:{reader.line_num}", root, viewpoint) for row in reader]


def _parse(row: dict[str, str], where: str, root: Path, viewpoint: str) -> HomographyPair:
    if any(row[name] is None for name in _COLUMNS):
        raise InputError(f"{where}: {len(_COLUMNS)} fields are needed")
    try:
        H = np.array([float(row[name]) for name in _MATRIX]).reshape(3, 3)
        size1 = (int(float(row["Wim"])), int(float(row["Him"])))
    except (ValueError, OverflowError) as error:
        raise InputError(f"{where}: {error}") from None
    path1, path2 = (root / row["obj"] / f"{row[name]}.ppm" for name in ("im1", "im2"))
    name = f"{row['obj']} {row['im1']}-{row['im2']}"
    return HomographyPair(name, viewpoint, path1, path2, check_matrix(H, where), size1)
