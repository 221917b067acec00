"""Lists of DTU pairs: only which views make a pair is taken from them.

The truth comes from the calibration, so that a list serves every layout and light. The formats:

- CSV with the columns scene, view1 and view2, and others that are ignored;
- SuperGlue's, see `cameras/pair_list.py`: scene and view come from the names of the images, in
  any of the layouts (`scan65/rect_012_3_r5000.png`, `scan65/images/00000011.jpg`).
"""

import csv
import re
from collections.abc import Collection, Iterator, Sequence
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
from dgc_pose.cameras.pair_list import FIELDS
from dgc_pose.errors import InputError
from dgc_pose.files.inputs import read_text
from dgc_pose.files.outputs import replaced, writing

PAIRS = 3000  # of the paper
COLUMNS = ("scene", "view1", "view2")
_SCENE = r"(?:dtu_)?scan(\d+)(?:_train)?"
_FROM_ONE = r"(?:rect|clean)_(\d{3})_\w+\.\w+"
_FROM_ZERO = r"(?:\d{2})?(\d{6})\.\w+"

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

    Raises InputError, with the path and the line number, for a line that is no pair, names a view
    that the data set lacks or repeats another line, and for a list without any pair; OSError if the
    file cannot be read.
    """
    path = Path(path)
    first: dict[Ids, int] = {}  # the line of each pair
    pairs = []
    for number, ids in _parse(path):
        if scenes is not None and ids[0] not in scenes:
            continue
        if ids in first:
            raise InputError(f"{path}:{number}: the pair of line {first[ids]} once more")
        first[ids] = number
        try:
            scene, view1, view2 = ids
            pairs.append(view_pair(dataset.scene(scene), view1, view2))
        except InputError as error:
            raise InputError(f"{path}:{number}: {error}") from None
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


def _parse(path: Path) -> Iterator[tuple[int, Ids]]:
    """The pairs by the numbers of their lines."""
    text = read_text(path, "a pair list")
    lines = [
        (number, line.strip())
        for number, line in enumerate(text.splitlines(), start=1)
        if line.strip() and not line.lstrip().startswith("#")
    ]
    header = [name.strip() for name in lines[0][1].split(",")] if lines else []
    if len(header) > 1:
        yield from _parse_csv(path, header, lines)
        return
    for number, line in lines:
        words, where = line.split(), f"{path}:{number}"
        if len(words) == FIELDS:
            yield number, _from_names(words[0], words[1], where)
        else:
            raise InputError(
                f"{where}: expected a CSV with {','.join(COLUMNS)}, or {FIELDS} fields as in "
                f"SuperGlue's lists, found {len(words)}"
            )


def _parse_csv(
    path: Path, header: Sequence[str], lines: Sequence[tuple[int, str]]
) -> Iterator[tuple[int, Ids]]:
    absent = [name for name in COLUMNS if name not in header]
    if absent:
        raise InputError(f"{path}:{lines[0][0]}: expected a column {absent[0]} in this CSV")
    columns = [header.index(name) for name in COLUMNS]
    for number, line in lines[1:]:
        words, where = [word.strip() for word in line.split(",")], f"{path}:{number}"
        if len(words) != len(header):
            raise InputError(f"{where}: expected {len(header)} columns, found {len(words)}")
        try:
            scene, view1, view2 = (int(words[column]) for column in columns)
        except ValueError:
            raise InputError(
                f"{where}: expected whole numbers of scene and views, found {line}"
            ) from None
        yield number, (scene, view1, view2)


def _from_names(name1: str, name2: str, where: str) -> Ids:
    (scene1, view1), (scene2, view2) = _from_name(name1, where), _from_name(name2, where)
    if scene1 != scene2:
        raise InputError(f"{where}: expected two views of one scene, found {name1} and {name2}")
    return scene1, view1, view2


def _from_name(name: str, where: str) -> tuple[int, int]:
    """Scene and view of an image by its name: files called rect or clean are numbered from 1, files
    with a number alone from 0."""
    *folders, file = PurePosixPath(name).parts or ("",)
    scenes = [match[1] for folder in folders if (match := re.fullmatch(_SCENE, folder))]
    for pattern, start in ((_FROM_ONE, 0), (_FROM_ZERO, 1)):
        if scenes and (match := re.fullmatch(pattern, file)):
            return int(scenes[-1]), int(match[1]) + start
    raise InputError(f"{where}: expected the name of a DTU image, found {name}")
