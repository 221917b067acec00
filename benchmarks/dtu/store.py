"""A run's folder: each pair on disk as soon as it is done, and the way back after a kill.

results.csv and timings.csv grow by the rows of a pair at a time, in the order of the list, whatever
the number of workers. What a kill leaves of a pair is dropped when the run is resumed, and the pair
is done again.
"""

from __future__ import annotations

import csv
import json
import os
from collections.abc import Mapping, Sequence
from contextlib import ExitStack
from dataclasses import fields
from pathlib import Path
from types import TracebackType
from typing import Any, TypeVar

from dgc_pose.benchmarks.dtu.records import DtuResult, DtuTiming
from dgc_pose.benchmarks.dtu.samples import write_sample
from dgc_pose.benchmarks.dtu.scoring import Scored
from dgc_pose.benchmarks.report import ResultsTable
from dgc_pose.errors import InputError

RESULTS, TIMINGS, SETTINGS = "results.csv", "timings.csv", "run.json"
Key = tuple[str, int, int, int]  # method, scene, view1, view2
Record = TypeVar("Record", DtuResult, DtuTiming)

_READERS: Mapping[str, Any] = {
    "str": str,
    "int": int,
    "float": float,
    "bool": {"True": True, "False": False}.__getitem__,
    "Protocol": str,
}


class RunStore:
    """The rows of one run. A context: the files are open within it.

    Args:
        out: the folder, made where it is not there.
        settings: all that the rows depend on; JSON.
        keys: for each pair of the list the keys of its rows, a method each.
        resume: go on with the run that is there; where there is none, begin one.

    Raises InputError where a run is there and `resume` is not asked for, where that run had other
    settings, or where its files are not as this class writes them.
    """

    def __init__(
        self,
        out: Path,
        settings: Mapping[str, Any],
        keys: Sequence[Sequence[Key]],
        *,
        resume: bool,
    ) -> None:
        self.out = out
        self.results: list[DtuResult] = []
        self.timings: list[DtuTiming] = []
        self._stack = ExitStack()
        known = out / SETTINGS
        if known.is_file():
            if not resume:
                raise InputError(f"{known} is there already: --resume goes on with that run")
            _require_same(known, settings)
        elif (out / RESULTS).exists():
            raise InputError(f"{out / RESULTS} is there already, and of no run of this command")
        else:
            out.mkdir(parents=True, exist_ok=True)
            _write_whole(known, json.dumps(settings, indent=2) + "\n")
        results = _read_rows(out / RESULTS, DtuResult)
        timings = _read_rows(out / TIMINGS, DtuTiming)
        self.done = _complete(keys, results, timings)  # pairs
        count = sum(len(rows) for rows in keys[: self.done])
        self.results, self.timings = results[:count], timings[:count]

    def __enter__(self) -> RunStore:
        self._results = self._open(RESULTS, DtuResult, self.results)
        self._timings = self._open(TIMINGS, DtuTiming, self.timings)
        return self

    def __exit__(
        self,
        kind: type[BaseException] | None,
        error: BaseException | None,
        trace: TracebackType | None,
    ) -> None:
        self._stack.close()

    def add(self, scored: Sequence[Scored]) -> None:
        """Put the next pair on disk: a row a method. Its row in results.csv comes last, so that a
        pair that has one has everything."""
        for one in scored:
            write_sample(self.out, one.result.key, one.sample)
        for one in scored:
            self._timings.add(one.timing)
            self.timings.append(one.timing)
        for one in scored:
            self._results.add(one.result)
            self.results.append(one.result)
        self.done += 1

    def _open(
        self, name: str, kind: type[DtuResult | DtuTiming], rows: Sequence[DtuResult | DtuTiming]
    ) -> ResultsTable:
        """The table with the rows that are kept, ready for more."""
        partial = self.out / f".{name}.partial"
        with partial.open("w", newline="", encoding="utf-8") as stream:
            table = ResultsTable(stream, kind)
            for row in rows:
                table.add(row)
        os.replace(partial, self.out / name)
        appended = (self.out / name).open("a", newline="", encoding="utf-8")
        return ResultsTable(self._stack.enter_context(appended), kind, header=False)


def _require_same(path: Path, settings: Mapping[str, Any]) -> None:
    try:
        before = json.loads(path.read_text(encoding="utf-8"))
    except ValueError:
        before = None
    if not isinstance(before, dict):
        raise InputError(f"{path}: not the settings of a run")
    for key, value in json.loads(json.dumps(settings)).items():
        if before.get(key) != value:
            raise InputError(
                f"{path}: that run had {key} {json.dumps(before.get(key))}, not "
                f"{json.dumps(value)}: the same options are needed to go on with it"
            )


def _complete(
    keys: Sequence[Sequence[Key]],
    results: Sequence[DtuResult],
    timings: Sequence[DtuTiming],
) -> int:
    """How many pairs from the start of the list have all their rows in both tables."""
    expected = [key for rows in keys for key in rows]
    for name, found in ((RESULTS, results), (TIMINGS, timings)):
        for number, (key, row) in enumerate(zip(expected, found, strict=False), start=2):
            if row.key != key:
                raise InputError(f"{name}:{number}: expected the row of {key}, found {row.key}")
        if len(found) > len(expected):
            raise InputError(f"{name}: more rows than the list has pairs")
    rows, pairs = min(len(results), len(timings)), 0
    while pairs < len(keys) and len(keys[pairs]) <= rows:
        rows -= len(keys[pairs])
        pairs += 1
    return pairs


def _read_rows(path: Path, kind: type[Record]) -> list[Record]:
    """The whole rows of a table; a row that a kill cut short is passed over."""
    if not path.exists():
        return []
    whole = path.read_bytes().rpartition(b"\n")[0].decode("utf-8", "replace")
    lines = csv.DictReader(whole.splitlines())
    names = [field.name for field in fields(kind)]
    if whole and lines.fieldnames != names:
        raise InputError(f"{path}:1: expected the columns {','.join(names)}")
    rows = []
    for number, line in enumerate(lines, start=2):
        try:
            values = {f.name: _READERS[str(f.type)](line[f.name]) for f in fields(kind)}
        except (KeyError, TypeError, ValueError):
            raise InputError(f"{path}:{number}: not a row of this table") from None
        rows.append(kind(**values))
    return rows


def _write_whole(path: Path, text: str) -> None:
    partial = path.with_name(f".{path.name}.partial")
    partial.write_text(text, encoding="utf-8")
    os.replace(partial, path)
