"""A run's folder: each pair on disk as soon as it is done, and the way back after a kill.

The tables grow by the rows of a pair at a time, in the order of the data set, whatever the number
of workers. If a kill leaves a pair half written, a resumed run drops it and does it again.
"""

from __future__ import annotations

import csv
import json
from collections import ChainMap
from collections.abc import Callable, Mapping, Sequence
from contextlib import ExitStack
from pathlib import Path
from typing import Any, Generic, TextIO, get_type_hints

from dgc_pose.benchmarks.scores import RESULTS, Score
from dgc_pose.errors import ArgumentName, InputError
from dgc_pose.files.inputs import read_as, read_bytes
from dgc_pose.files.json_files import read_json, write_json
from dgc_pose.files.outputs import only_writer, replaced, writing

SETTINGS = "run.json"
_READERS: Mapping[type, Callable[[str], Any]] = {  # of a cell; words of a Literal are text
    int: int,
    float: float,
    bool: {"True": True, "False": False}.__getitem__,
}


class RunStore(Generic[Score]):
    """The records of one run, in order. A context: the tables are open within it.

    Raises InputError if another run is writing there, if there is a run already and `resume` is not
    asked for, if that run had other settings, or if its files are not as this class writes them.
    """

    def __init__(
        self,
        out: Path | None,
        kind: type[Score],
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
        self.scores: list[Score] = []
        self.done = 0  # pairs
        self._kind = kind
        self._stack = ExitStack()
        self._tables: dict[str, TextIO] = {}
        if out is None:
            return
        out.mkdir(parents=True, exist_ok=True)
        with only_writer(out):
            if overwrite and not resume:
                for name in (*kind.tables, SETTINGS):  # a run without tables begins anew
                    (out / name).unlink(missing_ok=True)
            _begin(out, settings, resume)
            tables = [_read_rows(out / name, kind) for name in kind.tables]
        rows = [kind(**dict(ChainMap(*parts))) for parts in zip(*tables, strict=False)]
        self.done = len(rows) // methods
        self.scores = rows[: self.done * methods]

    def __enter__(self) -> RunStore[Score]:
        if self.out is not None:
            self._stack.enter_context(only_writer(self.out))
            for name in self._kind.tables:
                self._tables[name] = self._open(self.out / name)
        return self

    def __exit__(self, *error: object) -> None:
        self._stack.close()

    def add(self, scores: Sequence[Score]) -> None:
        """Put the next pair on disk: a row a method. Its rows in results.csv come last, so that a
        pair that has them has everything."""
        for name in reversed(self._tables):
            self._write(name, self._tables[name], scores)
        self.scores += scores
        self.done += 1

    def _open(self, path: Path) -> TextIO:
        """The table with the rows of the finished pairs, ready for more."""
        columns = [self._kind.headings.get(name, name) for name in self._kind.tables[path.name]]
        with (
            replaced(path) as stage,
            writing(stage),
            stage.open("w", newline="", encoding="utf-8") as stream,
        ):
            csv.writer(stream).writerow(columns)
            self._write(path.name, stream, self.scores)
        stream = path.open("a", newline="", encoding="utf-8")
        self._stack.callback(writing(path)(stream.close))
        return stream

    def _write(self, name: str, stream: TextIO, scores: Sequence[Score]) -> None:
        fields = self._kind.tables[name]
        with writing(stream.name):
            csv.writer(stream).writerows([getattr(s, field) for field in fields] for s in scores)
            stream.flush()


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


def _read_rows(path: Path, kind: type[Score]) -> list[dict[str, Any]]:
    """The complete rows of a table, by field; a row that a kill cut short is left out."""
    if not path.exists():
        return []
    hints, names = get_type_hints(kind), kind.tables[path.name]
    readers = {name: _READERS.get(hints[name], str) for name in names}
    with read_as("a table of results", path):
        whole = read_bytes(path).rpartition(b"\n")[0].decode()
        return [
            {name: readers[name](text) for name, text in zip(names, line, strict=True)}
            for line in [*csv.reader(whole.splitlines())][1:]
        ]
