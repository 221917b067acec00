"""A run's folder: each pair on disk as soon as it is done, and the way back after a kill.

The table grows by the rows of a pair at a time, in the order of the data set. If a kill leaves a
pair half written, a resumed run drops it and does it again.
"""

from __future__ import annotations

import csv
import json
from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from contextlib import contextmanager
from dataclasses import astuple, dataclass, fields
from pathlib import Path
from typing import Any, get_type_hints

from dgc_pose.errors import ArgumentName, InputError
from dgc_pose.system.files import naming_path, only_writer, read_as, read_bytes, replaced
from dgc_pose.system.texts import read_json, write_json

RESULTS, SETTINGS = "results.csv", "run.json"
_READERS: Mapping[type, Callable[[str], Any]] = {  # of a cell
    int: int,
    float: float,
    bool: {"True": True, "False": False}.__getitem__,
}


@dataclass(frozen=True)
class PairScore:
    """What one method made of one pair: a row of results.csv, whose columns are its fields.

    Errors are infinite without a pose; NaN is what a method does not say.

    D_e is the symmetric epipolar distance to the true epipolar lines, in pixels of the images that
    the methods see: over all cells of the dense map (NaN without one), and over the matches that
    the pose was estimated from (infinite without any).
    """

    method: str
    image1: str  # as the list names it
    image2: str
    true_rotation_deg: float
    status: str
    success: bool
    num_matches: int
    num_inliers: int
    inlier_ratio: float
    rotation_error_deg: float
    translation_error_deg: float  # 0 to 180
    translation_folded_deg: float  # min(e, 180 - e)
    match_seconds: float  # wall clock of the steps that changed the matches
    estimate_seconds: float  # wall clock of all estimations
    rotation_90_deg: float  # what the pose expects of its error; NaN if it has none
    translation_90_deg: float
    probability: float  # that R and t are both within 10 degrees
    focal1_error: float  # ln of the focal length of the pose over the true one; NaN without a pose
    focal2_error: float
    focal1_std: float  # what the pose expects of it; 0 if K was exact for it
    focal2_std: float
    doubts_camera: bool  # whether by the pose a K may be wrong
    epipolar_all_px: float  # medians
    epipolar_confident_px: float
    epipolar_all_mean_px: float
    epipolar_confident_mean_px: float


@contextmanager
def open_run(
    out: Path | None,
    methods: int,
    settings: Mapping[str, Any],
    *,
    resume: bool = False,
    overwrite: bool = False,
) -> Iterator[tuple[list[PairScore], Callable[[Sequence[PairScore]], None]]]:
    """The records of the pairs that are done, and a function that puts those of the next pair, one
    a method, on disk and among them.

    Raises InputError if another run is writing there, if there is a run already and `resume` is not
    asked for, if that run had other settings, or if its files are not as this function writes them.

    Args:
        out: the folder, made if missing; None keeps the records in memory alone.
        methods: records of each pair.
        settings: all that the records depend on; JSON.
        resume: go on with the run that `out` holds; begin one if it holds none.
        overwrite: drop the run that `out` holds.
    """
    if out is None:
        records: list[PairScore] = []
        yield records, records.extend
        return
    out.mkdir(parents=True, exist_ok=True)
    path = out / RESULTS
    with only_writer(out):
        if overwrite and not resume:
            for name in (RESULTS, SETTINGS):  # a run without its table begins anew
                (out / name).unlink(missing_ok=True)
        _begin(out, settings, resume)
        scores = _read_rows(path)
        del scores[len(scores) // methods * methods :]
        names = tuple(field.name for field in fields(PairScore))
        with replaced(path) as stage:
            _append(stage, [names, *map(astuple, scores)])

        def add(of_pair: Sequence[PairScore]) -> None:
            _append(path, map(astuple, of_pair))
            scores.extend(of_pair)

        yield scores, add


def _append(path: Path, rows: Iterable[tuple[Any, ...]]) -> None:
    with naming_path(path), path.open("a", newline="", encoding="utf-8") as table:
        csv.writer(table).writerows(rows)


def _begin(out: Path, settings: Mapping[str, Any], resume: bool) -> None:
    """Begin a run, or see that the one that is there can be gone on with."""
    path = out / SETTINGS
    if not path.is_file():
        if (out / RESULTS).exists():
            raise InputError(f"{out / RESULTS} is there already, and of no run of this command")
        write_json(path, settings)
        return
    if not resume:
        raise InputError(
            f"{path} is there already:", ArgumentName("resume"), "goes on with that run"
        )
    before = read_json(path, "the settings of a run")
    if not isinstance(before, dict):
        raise InputError(f"{path}: not the settings of a run")
    for key, value in json.loads(json.dumps(settings)).items():
        if before.get(key) != value:
            raise InputError(
                f"{path}: that run had {key} {json.dumps(before.get(key))}, not "
                f"{json.dumps(value)}: the same options are needed to go on with it"
            )


def _read_rows(path: Path) -> list[PairScore]:
    """The complete rows of a table; a row that a kill cut short is left out."""
    if not path.exists():
        return []
    readers = [_READERS.get(kind, str) for kind in get_type_hints(PairScore).values()]
    with read_as("a table of results", path):
        whole = read_bytes(path).rpartition(b"\n")[0].decode()
        return [
            PairScore(*(read(cell) for read, cell in zip(readers, line, strict=True)))
            for line in [*csv.reader(whole.splitlines())][1:]
        ]
