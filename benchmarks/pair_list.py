"""Pair lists in SuperGlue's format: one pair of images a line, with both K and the true pose.

A line has 38 fields separated by blanks: `name1 name2 rot1 rot2 K1[9] K2[9] T[16]`, the matrices
row by row, T = cam2_from_cam1. rot1 and rot2 count quarter turns to be applied to the images before
they are matched; lists with such rotations are refused, since K and T are of the images as stored.
"""

from __future__ import annotations

import io
from collections.abc import Iterable
from dataclasses import dataclass
from importlib.resources import files
from pathlib import Path

import numpy as np

from dgc_pose.cameras.camera import Camera, as_camera
from dgc_pose.errors import InputError
from dgc_pose.files.inputs import read_text
from dgc_pose.files.outputs import save_text
from dgc_pose.geometry.rotation import is_rotation

FIELDS = 38


@dataclass(frozen=True)
class Pair:
    """Two images with their cameras and the true relative pose."""

    name1: str  # as written in the list
    name2: str
    root: Path  # folder that the names are relative to
    camera1: Camera
    camera2: Camera
    R: np.ndarray  # (3, 3) rotation of cam2_from_cam1
    t: np.ndarray  # (3,) translation of cam2_from_cam1, the list's unit of length, never zero

    @property
    def path1(self) -> Path:
        return self.root / self.name1

    @property
    def path2(self) -> Path:
        return self.root / self.name2


def read_pairs(path: str | Path, root: str | Path | None = None) -> list[Pair]:
    """Read a pair list, whose image names are relative to `root`, by default the list's own folder.

    Raises InputError, with the path and the line number, for a line that is not as described at the
    top of this file, and for a list without any pair; OSError if the file cannot be read.
    """
    path = Path(path)
    folder = path.parent if root is None else Path(root)
    lines = io.StringIO(read_text(path, "a pair list"))
    pairs = [
        _parse_line(line, folder, f"{path}:{number}")
        for number, line in enumerate(lines, start=1)
        if line.strip()
    ]
    if not pairs:
        raise InputError(f"{path}: no pairs in this list")
    return pairs


def bundled_pair() -> Pair:
    """The rendered pair that comes with the package, with its exact pose."""
    return read_pairs(Path(str(files("dgc_pose") / "data" / "demo" / "pair.txt")))[0]


def write_pairs(path: str | Path, pairs: Iterable[Pair]) -> None:
    """Write pairs in SuperGlue's format, their names as they are.

    Raises InputError for a name with a blank in it, which the format cannot hold.
    """
    text = "".join(format_pair(pair) + "\n" for pair in pairs)
    save_text(path, text)


def format_pair(pair: Pair) -> str:
    """One line of a pair list, without its newline."""
    for name in (pair.name1, pair.name2):
        if len(name.split()) != 1:
            raise InputError(f"a pair list cannot hold the name {name!r}: no blanks, not empty")
    T = np.eye(4)
    T[:3, :3], T[:3, 3] = pair.R, pair.t
    numbers = np.concatenate([pair.camera1.K.ravel(), pair.camera2.K.ravel(), T.ravel()])
    return " ".join([pair.name1, pair.name2, "0", "0", *(f"{value:.12g}" for value in numbers)])


def _parse_line(line: str, root: Path, where: str) -> Pair:
    fields = line.split()
    if len(fields) != FIELDS:
        raise InputError(f"{where}: a pair needs {FIELDS} fields, and this line has {len(fields)}")
    if fields[2:4] != ["0", "0"]:
        raise InputError(
            f"{where}: rot1 rot2 must be 0 0, not {fields[2]} {fields[3]}: "
            "images that have to be rotated first are not supported"
        )
    numbers = _numbers(fields[4:], where)
    try:
        camera1 = as_camera(numbers[:9].reshape(3, 3), "K1")
        camera2 = as_camera(numbers[9:18].reshape(3, 3), "K2")
    except InputError as error:
        raise InputError(f"{where}: {error}") from None
    R, t = _pose(numbers[18:].reshape(4, 4), where)
    return Pair(fields[0], fields[1], root, camera1, camera2, R, t)


def _numbers(fields: list[str], where: str) -> np.ndarray:
    try:
        numbers = np.array([float(field) for field in fields])
    except ValueError as error:
        raise InputError(f"{where}: {error}") from None
    if not np.isfinite(numbers).all():
        raise InputError(f"{where}: the numbers must be finite")
    return numbers


def _pose(T: np.ndarray, where: str) -> tuple[np.ndarray, np.ndarray]:
    R, t = T[:3, :3], T[:3, 3]
    if not is_rotation(R):
        raise InputError(f"{where}: the upper left 3x3 of T is not a rotation")
    if not np.array_equal(T[3], [0, 0, 0, 1]):
        raise InputError(f"{where}: the last row of T must be 0 0 0 1")
    with np.errstate(over="ignore"):
        length = np.linalg.norm(t)
    if not 0 < length < np.inf:
        raise InputError(f"{where}: T has no translation, so its direction cannot be scored")
    # The nearest rotation: rounding e in a list could show as an angle of sqrt(e) otherwise.
    U, _, Vt = np.linalg.svd(R)
    return U @ Vt, t
