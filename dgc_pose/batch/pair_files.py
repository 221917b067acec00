"""Lists of pairs in files: two names a line, SuperGlue's lines, and CSV."""

from __future__ import annotations

import csv
from collections.abc import Mapping
from dataclasses import dataclass, field
from pathlib import Path

import numpy as np

from dgc_pose.cameras.camera import Camera, as_camera
from dgc_pose.errors import InputError
from dgc_pose.files.inputs import read_text

Names = tuple[str, str]

_FIELDS = (2, 4, 22, 38)  # of a line: names; with rotations; with both K; with the true pose
_HEADER = (("name1", "name2"), ("name0", "name1"), ("image1", "image2"), ("image0", "image1"))


@dataclass(frozen=True)
class PairList:
    """The pairs of a file, each once, and the cameras that it gives."""

    pairs: tuple[Names, ...]  # as written, in the file's order
    cameras: Mapping[str, Camera] = field(default_factory=dict)  # by image name; may be empty


def read_pair_list(path: Path) -> PairList:
    """Read a list of pairs: `name1 name2` a line, or SuperGlue's lines, whose K are read too; or
    a .csv whose first two columns are the names, with or without a heading.

    A pair that is listed again, in either order, counts once. Blank lines and those that begin
    with # are passed over. Raises InputError, with the path and the line, for anything else, for
    an image paired with itself and for a list without pairs; OSError if the file cannot be read.
    """
    text = read_text(path, "a list of pairs")
    is_table = path.suffix.lower() == ".csv"
    pairs: dict[frozenset[str], Names] = {}
    cameras: dict[str, Camera] = {}
    for number, line in enumerate(text.splitlines(), start=1):
        if not line.strip() or line.lstrip().startswith("#"):
            continue
        where = f"{path}:{number}"
        names = _table_row(line, where) if is_table else _plain_line(line, where, cameras)
        if not pairs and is_table and tuple(name.lower() for name in names) in _HEADER:
            continue
        if names[0] == names[1]:
            raise InputError(f"{where}: {names[0]} is paired with itself")
        pairs.setdefault(frozenset(names), names)
    if not pairs:
        raise InputError(f"{path}: no pairs in this list")
    return PairList(tuple(pairs.values()), cameras)


def _table_row(line: str, where: str) -> Names:
    try:
        cells = [cell.strip() for cell in next(csv.reader([line]))]
    except csv.Error as error:
        raise InputError(f"{where}: {error}") from None
    if len(cells) < 2 or not all(cells[:2]):
        raise InputError(f"{where}: expected name1,name2, not {line.strip()!r}")
    return cells[0], cells[1]


def _plain_line(line: str, where: str, cameras: dict[str, Camera]) -> Names:
    words = line.split()
    if len(words) not in _FIELDS:
        raise InputError(
            f"{where}: expected two names, or a line of SuperGlue's with 4, 22 or 38 fields, "
            f"not {len(words)} fields (names with blanks need a .csv)"
        )
    if len(words) > 2 and words[2:4] != ["0", "0"]:
        raise InputError(
            f"{where}: rot1 rot2 must be 0 0, not {words[2]} {words[3]}: "
            "images that have to be rotated first are not supported"
        )
    if len(words) > 4:
        _add_cameras(words, where, cameras)
    return words[0], words[1]


def _add_cameras(words: list[str], where: str, cameras: dict[str, Camera]) -> None:
    try:
        numbers = np.array(words[4:22], dtype=np.float64)
    except ValueError as error:
        raise InputError(f"{where}: {error}") from None
    for name, K in zip(words[:2], numbers.reshape(2, 3, 3), strict=True):
        try:
            camera = as_camera(K, "K")
        except InputError as error:
            raise InputError(f"{where}: {error}") from None
        if not np.array_equal(cameras.setdefault(name, camera).K, camera.K):
            raise InputError(f"{where}: another K of {name} than in a line before")
