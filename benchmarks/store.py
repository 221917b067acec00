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

from dgc_pose.benchmarks.posed_pairs import PairSet
from dgc_pose.benchmarks.scores import RESULTS, Key, PoseScore, Score
from dgc_pose.errors import ArgumentName, InputError
from dgc_pose.files.inputs import read_as, read_bytes
from dgc_pose.files.json_files import read_json
from dgc_pose.files.outputs import only_writer, replaced, write_text, writing

SETTINGS = "run.json"
_READERS: Mapping[type, Callable[[str], Any]] = {  # of a cell; words of a Literal are text
    int: int,
    float: float,
    bool: {"True": True, "False": False}.__getitem__,
}
_RESUME = ArgumentName("resume")


class RunStore(Generic[Score]):
    """The records of one run, in order. A context: the tables are open within it.

    Raises InputError if there is a run already and `resume` is not asked for, if that run had other
    settings, or if its files are not as this class writes them.
    """

    def __init__(
        self,
        out: Path | None,
        kind: type[Score],
        keys: Sequence[Sequence[Key]],
        settings: Mapping[str, Any],
        *,
        resume: bool = False,
        overwrite: bool = False,
    ) -> None:
        """
        Args:
            out: the folder, made if missing; None keeps the records in memory alone.
            keys: for each pair the keys of its records, one a method.
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
        if overwrite and not resume:
            for name in (*kind.tables, SETTINGS):  # a run without tables begins anew
                (out / name).unlink(missing_ok=True)
        _begin(out, settings, resume)
        tables = [_read_rows(out / name, kind, keys) for name in kind.tables]
        rows = [kind(**dict(ChainMap(*parts))) for parts in zip(*tables, strict=False)]
        methods = len(keys[0]) if keys else 1
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
        with (
            replaced(path) as stage,
            writing(stage),
            stage.open("w", newline="", encoding="utf-8") as stream,
        ):
            csv.writer(stream).writerow(_columns(self._kind, path.name))
            self._write(path.name, stream, self.scores)
        stream = path.open("a", newline="", encoding="utf-8")
        self._stack.callback(writing(path)(stream.close))
        return stream

    def _write(self, name: str, stream: TextIO, scores: Sequence[Score]) -> None:
        fields = self._kind.tables[name]
        with writing(stream.name):
            csv.writer(stream).writerows([getattr(s, field) for field in fields] for s in scores)
            stream.flush()


def keys_of(pairs: PairSet[Score], methods: Sequence[str]) -> list[list[Key]]:
    """The keys of the records of each pair, one a method."""
    identity = pairs.kind.identity[1:]
    return [
        [(method, *(ids[name] for name in identity)) for method in methods] for ids in pairs.ids
    ]


def _columns(kind: type[PoseScore], table: str) -> list[str]:
    return [kind.headings.get(name, name) for name in kind.tables[table]]


def _begin(out: Path, settings: Mapping[str, Any], resume: bool) -> None:
    """Begin a run, or see that the one that is there can be gone on with."""
    path = out / SETTINGS
    if not path.is_file():
        if (out / RESULTS).exists():
            raise InputError(f"{out / RESULTS} is there already, and of no run of this command")
        out.mkdir(parents=True, exist_ok=True)
        write_text(path, json.dumps(settings, indent=2) + "\n")
        return
    if not resume:
        raise InputError(f"{path} is there already:", _RESUME, "goes on with that run")
    before = read_json(path, "the settings of a run")
    if not isinstance(before, dict):
        raise InputError(f"{path}: not the settings of a run")
    for key, value in json.loads(json.dumps(settings)).items():
        if before.get(key) != value:
            raise InputError(
                f"{path}: that run had {key} {json.dumps(before.get(key))}, not "
                f"{json.dumps(value)}: the same options are needed to go on with it"
            )


def _read_rows(
    path: Path, kind: type[Score], keys: Sequence[Sequence[Key]]
) -> list[dict[str, Any]]:
    """The complete rows of a table, by field; a row that a kill cut short is left out."""
    whole = read_bytes(path).rpartition(b"\n")[0] if path.exists() else b""
    hints, columns = get_type_hints(kind), _columns(kind, path.name)
    readers = {name: _READERS.get(hints[name], str) for name in kind.tables[path.name]}
    expected = [key for of_pair in keys for key in of_pair]
    rows = []
    with read_as("a table of results", path):
        lines = csv.reader(whole.decode("utf-8", "replace").splitlines())
        if whole and next(lines) != columns:
            raise InputError(f"{path}:1: expected the columns {','.join(columns)}")
        for number, line in enumerate(lines):
            try:
                cells = zip(readers.items(), line, strict=True)
                row = {name: read(text) for (name, read), text in cells}
                in_order = tuple(row[name] for name in kind.identity) == expected[number]
            except (KeyError, ValueError, IndexError):
                in_order = False
            if not in_order:
                raise InputError(f"{path}:{number + 2}: not the row that this run has here")
            rows.append(row)
    return rows
