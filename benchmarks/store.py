"""A run's folder: each pair on disk as soon as it is done, and the way back after a kill.

The table grows by the rows of a pair at a time, in the order of the data set. If a kill leaves a
pair half written, a resumed run drops it and does it again.
"""

from __future__ import annotations

import csv
import json
from collections.abc import Callable, Mapping, Sequence
from contextlib import ExitStack
from dataclasses import astuple, fields
from pathlib import Path
from typing import Any, TextIO, get_type_hints

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


class RunStore:
    """The records of one run, in order. A context: the table is open within it.

    Raises InputError if another run is writing there, if there is a run already and `resume` is not
    asked for, if that run had other settings, or if its files are not as this class writes them.
    """

    def __init__(
        self,
        out: Path | None,
        methods: int,
        settings: Mapping[str, Any],
        *,
        resume: bool = False,
        overwrite: bool = False,
    ) -> None:
        """
        Args:
            out: the folder, made if missing; None keeps the records in memory alone.
            methods: records of each pair.
            settings: all that the records depend on; JSON.
            resume: go on with the run that `out` holds; begin one if it holds none.
            overwrite: drop the run that `out` holds.
        """
        self.out = out
        self.scores: list[PairScore] = []
        self.done = 0  # pairs
        self._stack = ExitStack()
        self._table: TextIO | None = None
        if out is None:
            return
        out.mkdir(parents=True, exist_ok=True)
        with only_writer(out):
            if overwrite and not resume:
                for name in (RESULTS, SETTINGS):  # a run without its table begins anew
                    (out / name).unlink(missing_ok=True)
            _begin(out, settings, resume)
            rows = _read_rows(out / RESULTS)
        self.done = len(rows) // methods
        self.scores = rows[: self.done * methods]

    def __enter__(self) -> RunStore:
        if self.out is not None:
            self._stack.enter_context(only_writer(self.out))
            path = self.out / RESULTS
            with (
                replaced(path) as stage,
                writing(stage),
                stage.open("w", newline="", encoding="utf-8") as table,
            ):
                csv.writer(table).writerow([field.name for field in fields(PairScore)])
                csv.writer(table).writerows(map(astuple, self.scores))
            self._table = path.open("a", newline="", encoding="utf-8")
            self._stack.callback(writing(path)(self._table.close))
        return self

    def __exit__(self, *error: object) -> None:
        self._stack.close()

    def add(self, scores: Sequence[PairScore]) -> None:
        """Put the next pair on disk: a row a method."""
        if self._table is not None:
            with writing(self._table.name):
                csv.writer(self._table).writerows(map(astuple, scores))
                self._table.flush()
        self.scores += scores
        self.done += 1


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
