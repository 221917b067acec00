"""A run's folder: each pair on disk as soon as it is done, and the way back after a kill.

The table grows by the rows of a pair at a time, in the order of the data set. If a kill leaves a
pair half written, a resumed run drops it and does it again.
"""

from __future__ import annotations

import csv
import json
from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from contextlib import contextmanager
from dataclasses import astuple, fields
from pathlib import Path
from typing import Any, get_type_hints

from dgc_pose.benchmarks.scores import PairScore
from dgc_pose.errors import ArgumentName, InputError
from dgc_pose.files.inputs import read_as, read_bytes
from dgc_pose.files.json_files import read_json, write_json
from dgc_pose.files.outputs import only_writer, replaced, writing

RESULTS, SETTINGS = "results.csv", "run.json"
_READERS: Mapping[type, Callable[[str], Any]] = {  # of a cell
    int: int,
    float: float,
    bool: {"True": True, "False": False}.__getitem__,
}


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
    with writing(path), path.open("a", newline="", encoding="utf-8") as table:
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
