"""Lists of pairs of images: SuperGlue's format, two names a line, and CSV.

A full line in SuperGlue's format has 38 fields: `name1 name2 rot1 rot2 K1[9] K2[9] T[16]`, the
matrices row by row, T = cam2_from_cam1. A shorter line ends after the names, the rotations or the
K. rot1 and rot2 count quarter turns to apply to the images before matching. Lists with such
rotations raise InputError, since K and T refer to the images as stored.
"""

import csv
import gzip
import re
from collections.abc import Iterable, Iterator, Mapping
from contextlib import contextmanager
from dataclasses import dataclass
from importlib.resources import files
from itertools import chain
from pathlib import Path

import numpy as np

from dgc_pose.cameras.camera import Camera, matrix_camera
from dgc_pose.errors import InputError, shortened
from dgc_pose.geometry.rotation import is_rotation
from dgc_pose.system.files import TEXT_BYTES, read_as, read_text, save_text

FIELDS = 38
Names = tuple[str, str]

_DATA = Path(str(files("dgc_pose"))) / "data"
_SHORTER = (2, 4, 22)  # fields of a line that ends after the names, the rotations or the K
_COLUMN = re.compile(r"[^\d./\\]+[01][^\d./\\]*")  # no dot or slash: not a path


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


@dataclass(frozen=True)
class PairList:
    """The images, pairs and cameras of a list or a COLMAP database."""

    names: tuple[str, ...]  # as written
    pairs: tuple[Names, ...]  # each once; empty for a database without matches
    cameras: Mapping[str, Camera]  # by image name; only calibrated cameras


def read_pairs(path: str | Path, root: str | Path | None = None) -> list[Pair]:
    """Read a list of full lines in SuperGlue's format, as text or .gz.

    root: the folder that the image names are relative to, by default the folder of the list. Skips
    blank lines and lines that begin with #. Raises InputError, with the path and the line number,
    for any other line, and for a list without a pair; OSError if the file cannot be read.
    """
    path = Path(path)
    folder = path.parent if root is None else Path(root)
    pairs = []
    for line, where in _lines(path):
        words = line.split()
        with _naming_line(where):
            if len(words) != FIELDS:
                raise InputError(f"a pair needs {FIELDS} fields, and this line has {len(words)}")
            camera1, camera2 = _cameras(words)
            R, t = _pose(np.array(words[22:], np.float64).reshape(4, 4))
        pairs.append(Pair(words[0], words[1], folder, camera1, camera2, R, t))
    if not pairs:
        raise InputError(f"{path}: no pairs in this list")
    return pairs


def read_pair_list(path: Path) -> PairList:
    """Read a list of pairs, without poses: full or shorter lines in SuperGlue's format, including
    their K; or a .csv whose first two columns are the names, with or without a heading.

    A pair listed twice, in either order, counts once. Raises as `read_pairs` does, and InputError
    for an image paired with itself and for two K of one image.
    """
    is_table = path.suffix.lower() == ".csv"
    pairs: dict[frozenset[str], Names] = {}
    cameras: dict[str, Camera] = {}
    for line, where in _lines(path):
        with _naming_line(where):
            words = line.split()
            if is_table:
                words = [word.strip() for word in next(csv.reader([line]))[:2]]
            if len(words) not in (*_SHORTER, FIELDS) or not all(words):
                raise InputError(
                    "expected two names, or SuperGlue's 4, 22 or 38 fields, not "
                    f"{shortened(line.strip())!r} (names with blanks need a .csv)"
                )

            name1, name2 = words[:2]
            if not pairs and is_table and _is_heading(name1.lower(), name2.lower()):
                continue
            if name1 == name2:
                raise InputError(f"{name1} is paired with itself")
            for name, camera in zip((name1, name2), _cameras(words), strict=False):
                if not np.array_equal(cameras.setdefault(name, camera).K, camera.K):
                    raise InputError(f"K of {name} differs from an earlier line")
        pairs.setdefault(frozenset((name1, name2)), (name1, name2))

    if not pairs:
        raise InputError(f"{path}: no pairs in this list")
    listed = tuple(pairs.values())
    return PairList(tuple(dict.fromkeys(chain.from_iterable(listed))), listed, cameras)


def rendered_pair() -> Pair:
    """The rendered pair in the package, with its exact pose."""
    return read_pairs(_DATA / "rendered" / "pair.txt")[0]


def bundled_photographs() -> tuple[Path, Path]:
    """The two phone photographs in the package, with unknown K."""
    return _DATA / "photographs" / "image1.jpg", _DATA / "photographs" / "image2.jpg"


def write_pairs(path: str | Path, pairs: Iterable[Pair]) -> None:
    """Write pairs in SuperGlue's format. Raises InputError for an empty name or one with blanks,
    which the format cannot hold."""
    lines = []
    for pair in pairs:
        for name in (pair.name1, pair.name2):
            if len(name.split()) != 1:
                raise InputError(f"a pair list cannot hold the name {name!r}: no blanks, not empty")
        T = np.block([[pair.R, pair.t[:, None]], [0, 0, 0, 1]])
        numbers = np.concatenate([pair.camera1.K.ravel(), pair.camera2.K.ravel(), T.ravel()])
        words = pair.name1, pair.name2, "0", "0", *(f"{value:.12g}" for value in numbers)
        lines.append(" ".join(words) + "\n")
    save_text(path, "".join(lines))


def _lines(path: Path) -> Iterator[tuple[str, str]]:
    """The lines that are neither blank nor comments, each with its place "path:number"."""
    if path.suffix == ".gz":
        with read_as("a packed list of pairs", path), gzip.open(path) as stream:
            text = stream.read(TEXT_BYTES).decode("utf-8-sig")
    else:
        text = read_text(path, "a list of pairs")
    for number, line in enumerate(text.splitlines(), start=1):
        if line.strip() and not line.lstrip().startswith("#"):
            yield line, f"{path}:{number}"


def _is_heading(first: str, second: str) -> bool:
    """Whether two names are column headings such as image1_path and image2_path: they differ only
    in a digit, 0 and 1 or 1 and 2."""
    alike = {first.replace("0", "1"), first.replace("1", "2")} - {first}
    return _COLUMN.fullmatch(first) is not None and second in alike


@contextmanager
def _naming_line(where: str) -> Iterator[None]:
    """Prefix errors in the block with the place of the line."""
    try:
        yield
    except (InputError, ValueError, csv.Error) as error:
        raise InputError(f"{where}: {error}") from None


def _cameras(words: list[str]) -> list[Camera]:
    if len(words) > 2 and words[2:4] != ["0", "0"]:
        raise InputError(
            f"rot1 rot2 must be 0 0, not {words[2]} {words[3]}: images that have to be rotated "
            "first are not supported"
        )
    matrices = np.array(words[4:22], np.float64).reshape(-1, 3, 3)
    return [matrix_camera(K, name) for K, name in zip(matrices, ("K1", "K2"), strict=False)]


def _pose(T: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    R = T[:3, :3]
    t = T[:3, 3]
    if not (is_rotation(R) and np.array_equal(T[3], [0, 0, 0, 1])):
        raise InputError("T is not a rotation and translation with the last row 0 0 0 1")
    with np.errstate(over="ignore"):
        length = np.linalg.norm(t)
    if not 0 < length < np.inf:
        raise InputError("T has no translation, so its direction cannot be scored")
    # The nearest rotation: otherwise rounding e in a list could become an angle error of sqrt(e).
    U, _, Vt = np.linalg.svd(R)
    return U @ Vt, t
