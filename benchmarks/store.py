"""A run's folder: each pair on disk as soon as it is done, and the way back after a kill.

The tables grow by the rows of a pair at a time, in the order of the data set, whatever the number
of workers. If a kill leaves a pair half written, a resumed run drops it and does it again.
"""

from __future__ import annotations

import csv
import json
from collections.abc import Callable, Mapping, Sequence
from contextlib import ExitStack
from pathlib import Path
from types import TracebackType
from typing import Any, Generic, TextIO, get_type_hints

from dgc_pose.benchmarks.posed_pairs import PairSet
from dgc_pose.benchmarks.samples import write_sample
from dgc_pose.benchmarks.scores import RESULTS, Key, PoseScore, Score
from dgc_pose.benchmarks.scoring import Scored
from dgc_pose.errors import InputError
from dgc_pose.files.inputs import read_as, read_bytes
from dgc_pose.files.json_files import read_json
from dgc_pose.files.outputs import only_writer, replaced, write_text, writing

SETTINGS = "run.json"
_READERS: Mapping[type, Callable[[str], Any]] = {  # of a cell; words of a Literal are text
    int: int,
    float: float,
    bool: {"True": True, "False": False}.__getitem__,
}


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
        samples: bool = False,
    ) -> None:
        """
        Args:
            out: the folder, made if missing; None keeps the records in memory alone.
            kind: of the records.
            keys: for each pair the keys of its records, one a method.
            settings: all that the records depend on; JSON.
            resume: go on with the run that `out` holds; begin one if it holds none.
            overwrite: drop the run that `out` holds.
            samples: write the samples of matches too.
        """
        self.out = out
        self.scores: list[Score] = []
        self.done = 0  # pairs
        self._kind = kind
        self._samples = samples
        self._stack = ExitStack()
        self._tables: dict[str, TextIO] = {}
        if out is not None:
            if overwrite and not resume:
                _drop(out, kind)
            _require(out, settings, resume)
            tables = {name: _read_rows(out / name, kind, name) for name in kind.tables}
            self.done = _complete(kind, keys, tables)
            count = sum(len(own) for own in keys[: self.done])
            for rows in zip(*(rows[:count] for rows in tables.values()), strict=True):
                self.scores.append(kind(**{k: v for row in rows for k, v in row.items()}))

    def __enter__(self) -> RunStore[Score]:
        if self.out is not None:
            self._stack.enter_context(only_writer(self.out))
            for name in self._kind.tables:
                self._tables[name] = self._open(self.out / name)
        return self

    def __exit__(
        self,
        kind: type[BaseException] | None,
        error: BaseException | None,
        trace: TracebackType | None,
    ) -> None:
        self._stack.close()

    def add(self, scored: Sequence[Scored[Score]]) -> None:
        """Put the next pair on disk: a row a method. Its rows in results.csv come last, so that a
        pair that has them has everything."""
        for one in scored:
            if self.out is not None and self._samples:
                write_sample(self.out, one.score.key, one.sample)
            self.scores.append(one.score)
        for name in reversed(self._tables):
            for one in scored:
                self._write(name, self._tables[name], one.score)
        self.done += 1

    def _open(self, path: Path) -> TextIO:
        """The table with the rows that are kept, ready for more."""
        with (
            replaced(path) as stage,
            writing(stage),
            stage.open("w", newline="", encoding="utf-8") as stream,
        ):
            csv.writer(stream).writerow(_columns(self._kind, path.name))
            for score in self.scores:
                self._write(path.name, stream, score)
        stream = path.open("a", newline="", encoding="utf-8")
        self._stack.callback(writing(path)(stream.close))
        return stream

    def _write(self, name: str, stream: TextIO, score: Score) -> None:
        row = [getattr(score, field) for field in self._kind.tables[name]]
        with writing(stream.name):
            csv.writer(stream).writerow(row)
            stream.flush()


def keys_of(pairs: PairSet[Score], methods: Sequence[str]) -> list[list[Key]]:
    """The keys of the records of each pair, one a method."""
    identity = pairs.kind.identity[1:]
    found = [tuple(ids[name] for name in identity) for ids in pairs.ids]
    return [[(method, *own) for method in methods] for own in found]


def _columns(kind: type[PoseScore], table: str) -> list[str]:
    return [kind.headings.get(name, name) for name in kind.tables[table]]


def _drop(out: Path, kind: type[PoseScore]) -> None:
    """Remove the tables of a run, its settings last: a run without tables begins anew."""
    for name in (*kind.tables, SETTINGS):
        (out / name).unlink(missing_ok=True)


def _require(out: Path, settings: Mapping[str, Any], resume: bool) -> None:
    """Begin a run, or see that the one that is there can be gone on with."""
    known = out / SETTINGS
    if known.is_file():
        if not resume:
            raise InputError(f"{known} is there already: --resume goes on with that run")
        _require_same(known, settings)
    elif (out / RESULTS).exists():
        raise InputError(f"{out / RESULTS} is there already, and of no run of this command")
    else:
        out.mkdir(parents=True, exist_ok=True)
        write_text(known, json.dumps(settings, indent=2) + "\n")


def _require_same(path: Path, settings: Mapping[str, Any]) -> None:
    before = read_json(path, "the settings of a run")
    if not isinstance(before, dict):
        raise InputError(f"{path}: not the settings of a run")
    for key, value in json.loads(json.dumps(settings)).items():
        if before.get(key) != value:
            raise InputError(
                f"{path}: that run had {key} {json.dumps(before.get(key))}, not "
                f"{json.dumps(value)}: the same options are needed to go on with it"
            )


def _complete(
    kind: type[Score], keys: Sequence[Sequence[Key]], tables: Mapping[str, list[dict[str, Any]]]
) -> int:
    """How many pairs from the first on have all their rows in all tables."""
    expected = [key for own in keys for key in own]
    for name, found in tables.items():
        for number, (key, row) in enumerate(zip(expected, found, strict=False), start=2):
            own = tuple(row[field] for field in kind.identity)
            if own != key:
                raise InputError(f"{name}:{number}: expected the row of {key}, found {own}")
        if len(found) > len(expected):
            raise InputError(f"{name}: more rows than the list has pairs")
    rows, pairs = min(map(len, tables.values())), 0
    while pairs < len(keys) and len(keys[pairs]) <= rows:
        rows -= len(keys[pairs])
        pairs += 1
    return pairs


def _read_rows(path: Path, kind: type[Score], table: str) -> list[dict[str, Any]]:
    """The complete rows of a table, by field; a row that a kill cut short is left out."""
    if not path.exists():
        return []
    whole = read_bytes(path).rpartition(b"\n")[0].decode("utf-8", "replace")
    lines = csv.reader(whole.splitlines())
    columns = _columns(kind, table)
    hints = get_type_hints(kind)
    rows = []
    with read_as("a table of results", path):
        if whole and next(lines, None) != columns:
            raise InputError(f"{path}:1: expected the columns {','.join(columns)}")
        found = list(lines)
    for number, line in enumerate(found, start=2):
        try:
            cells = zip(kind.tables[table], line, strict=True)
            rows.append({name: _READERS.get(hints[name], str)(text) for name, text in cells})
        except (KeyError, TypeError, ValueError):
            raise InputError(f"{path}:{number}: not a row of this table") from None
    return rows
