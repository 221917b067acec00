"""Lists of DTU pairs: only which views make a pair is taken from them.

The truth comes from the calibration, so that a list serves every layout and light. The formats:

- CSV with the columns scene, view1 and view2, and others that are ignored;
- SuperGlue's, see `cameras/pair_list.py`: scene and view come from the names of the images, in
  any of the layouts (`scan65/rect_012_3_r5000.png`, `scan65/images/00000011.jpg`).
"""

import csv
import re
from collections.abc import Collection, Sequence
from dataclasses import asdict, fields
from pathlib import Path, PurePosixPath

from dgc_pose.benchmarks.dtu.dataset import Dataset
from dgc_pose.benchmarks.dtu.view_pairs import (
    ViewPair,
    ViewPairOptions,
    draw,
    find_view_pairs,
    view_pair,
)
from dgc_pose.cameras.pair_list import read_pairs
from dgc_pose.errors import InputError
from dgc_pose.files.inputs import read_as, read_text
from dgc_pose.files.outputs import replaced, writing

PAIRS = 3000  # of the paper
_COLUMNS = ("scene", "view1", "view2")
_SCENE = re.compile(r"(?:dtu_)?scan(\d+)(?:_train)?")
# Files called rect or clean are numbered from 1, files with a number alone from 0.
_FROM_ONE = re.compile(r"(?:rect|clean)_(\d{3})_\w+\.\w+")
_FROM_ZERO = re.compile(r"(?:\d{2})?(\d{6})\.\w+")

Ids = tuple[int, int, int]  # scene, view1, view2


def choose_pairs(
    dataset: Dataset, pairs: str | int, *, seed: int, scenes: Sequence[int] | None = None
) -> list[ViewPair]:
    """The pairs that a number (so many, drawn by the seed) or the path of a list stands for, scene
    by scene, so that cached images serve all pairs of their scene.

    Raises InputError if the number is not positive or no views fit, and what `read_pair_file`
    raises.
    """
    try:
        number = None if Path(str(pairs)).exists() else int(pairs)
    except ValueError:
        number = None
    if number is None:
        chosen = read_pair_file(str(pairs), dataset, scenes=scenes)
    else:
        options = ViewPairOptions(pairs=number, seed=seed)
        chosen = draw(find_view_pairs(dataset, options), options)
        if not chosen:
            raise InputError(
                f"{dataset.root}: no two views are {options.min_rotation:g} to "
                f"{options.max_rotation:g} degrees apart and share {options.min_overlap:g} of what "
                "they see"
            )
    return sorted(chosen, key=lambda pair: pair.scene)


def read_pair_file(
    path: str | Path, dataset: Dataset, *, scenes: Collection[int] | None = None
) -> list[ViewPair]:
    """Read a list in one of the formats at the top of this file; with `scenes`, of these alone.

    Raises InputError, with the path, for a line that is no pair or names a view that the data set
    lacks, and for a list without any pair; OSError if the file cannot be read.
    """
    text = read_text(path, "a pair list")
    is_table = "," in text.partition("\n")[0]
    pairs = []
    for where, (scene, view1, view2) in _table(path, text) if is_table else _names(path):
        if scenes is None or scene in scenes:
            try:
                pairs.append(view_pair(dataset.scene(scene), view1, view2))
            except InputError as error:
                raise InputError(f"{where}: {error}") from None
    if not pairs:
        raise InputError(f"{path}: no pairs in this list")
    return pairs


def write_pair_csv(path: str | Path, pairs: Sequence[ViewPair]) -> None:
    """Write pairs as CSV, with their rotation, overlap and baseline."""
    with (
        replaced(Path(path)) as temporary,
        writing(temporary),
        temporary.open("w", newline="", encoding="utf-8") as stream,
    ):
        names = [field.name for field in fields(ViewPair)]
        writer = csv.DictWriter(stream, names, lineterminator="\n")
        writer.writeheader()
        for pair in pairs:
            row = asdict(pair)
            writer.writerow({k: f"{v:.4f}" if isinstance(v, float) else v for k, v in row.items()})


def _table(path: str | Path, text: str) -> list[tuple[str, Ids]]:
    """The pairs of a CSV, each with its path and line."""
    rows = csv.DictReader(text.splitlines())
    pairs: list[tuple[str, Ids]] = []
    with read_as("a table with columns scene, view1 and view2", path):
        names = {name.strip(): name for name in rows.fieldnames or ()}
        columns = [names[name] for name in _COLUMNS]
        for row in rows:
            where = f"{path}:{rows.line_num}"
            with read_as("a row of whole numbers", where):
                scene, view1, view2 = (int(row[column]) for column in columns)
            pairs.append((where, (scene, view1, view2)))
    return pairs


def _names(path: str | Path) -> list[tuple[str, Ids]]:
    """The pairs of a list in SuperGlue's format, each with its path and images."""
    pairs: list[tuple[str, Ids]] = []
    for pair in read_pairs(path):
        where = f"{path}: {pair.name1} {pair.name2}"
        (scene, view1), (other, view2) = (_view(name, where) for name in (pair.name1, pair.name2))
        if scene != other:
            raise InputError(f"{where}: expected two views of one scene")
        pairs.append((where, (scene, view1, view2)))
    return pairs


def _view(name: str, where: str) -> tuple[int, int]:
    """Scene and view of an image by its name."""
    *folders, file = PurePosixPath(name).parts or ("",)
    scenes = [match[1] for folder in folders if (match := _SCENE.fullmatch(folder))]
    for pattern, start in ((_FROM_ONE, 0), (_FROM_ZERO, 1)):
        if scenes and (match := pattern.fullmatch(file)):
            return int(scenes[-1]), int(match[1]) + start
    raise InputError(f"{where}: expected the names of DTU images")
