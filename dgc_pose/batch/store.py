"""The folder of a batch: finished blocks as they come, and the result when all are there.

- `plan.json`: see `plan`.
- `parts/`: a file for each finished block, which appears whole or not at all.
- `pairs.jsonl` or `pairs.parquet`, `matches.h5`, `summary.json`: the result, in the order of the
  pairs whatever the order in which they were done; the parts are removed then.
"""

from __future__ import annotations

import json
import os
import re
import shutil
from collections import OrderedDict
from collections.abc import Iterator, Mapping
from contextlib import ExitStack, suppress
from dataclasses import dataclass
from itertools import repeat
from pathlib import Path
from typing import Any

import h5py
import numpy as np

from dgc_pose.batch.matches_file import group_name, new_file, open_matches, write_matches
from dgc_pose.batch.plan import Plan, parse_states
from dgc_pose.batch.rows import (
    FAILED,
    PairRow,
    parse_row,
    read_rows,
    row_data,
    write_jsonl,
    write_parquet,
)
from dgc_pose.batch.source import FileState
from dgc_pose.batch.work import Matched
from dgc_pose.errors import InputError
from dgc_pose.files.inputs import read_as
from dgc_pose.files.json_files import read_json
from dgc_pose.files.outputs import replaced, require_room, writing

SUMMARY, MATCHES, PARTS = "summary.json", "matches.h5", "parts"
_PART = re.compile(r"\d{9,}\.h5")
_OPEN_PARTS = 64  # while the result is put together
_SUMMARY: Mapping[str, type | tuple[type, ...]] = {  # what is read again
    **dict.fromkeys(("images", "guessed_focal", "pairs", "poses", "matched_now"), int),
    **dict.fromkeys(("bad_images", "by_status"), dict),
    "seconds": (int, float),
}


def rows_path(out: Path, plan: Plan) -> Path:
    """The table of the rows."""
    return out / f"pairs.{plan.settings['format']}"


def read_result(out: Path, plan: Plan) -> Iterator[PairRow]:
    """The rows of a finished batch. Raises InputError, with the path, unless each pair has one."""
    count = 0
    for row in read_rows(rows_path(out, plan)):
        count += 1
        yield row
    if count != len(plan.pairs):
        raise InputError(
            f"{rows_path(out, plan)}: {count} rows, and the plan has {len(plan.pairs)} pairs"
        )


def read_summary(out: Path) -> Mapping[str, Any]:
    """The summary of a finished batch, checked as far as it is read again. Raises InputError, with
    the path, if it is none."""
    path = out / SUMMARY
    data = read_json(path, "the summary of a batch")
    if not isinstance(data, dict) or not all(
        isinstance(data.get(name), kind) for name, kind in _SUMMARY.items()
    ):
        raise InputError(f"{path}: not the summary of a batch")
    return data


class PartStore:
    """The finished blocks of a batch, and the result of an earlier run of it."""

    def __init__(self, out: Path, plan: Plan, before: Plan | None = None) -> None:
        """Reads which pairs are done: in a part, or in the result of the plan `before`, by
        photographs that have not changed since, and without a failure. A part that cannot be read
        is removed."""
        self.out = out
        self.plan = plan
        self.folder = out / PARTS
        self._where: dict[int, Path] = {}  # the part of each pair that is in one
        self._kept: set[int] = set()  # pairs that the result has
        self._bad: dict[str, str] = {}  # of the result, the reason by name
        self._number = -1  # of the last part; later parts hold for pairs that are in several
        self._has_result = before is not None and (out / SUMMARY).is_file()
        if before is not None and self._has_result:
            self._read_result(before)
        self.folder.mkdir(exist_ok=True)
        for path in self._parts():
            try:
                indices = read_part(path, plan)
            except (InputError, OSError):
                path.unlink()
                continue
            self._where.update(dict.fromkeys(indices, path))
            self._number = int(path.stem)

    @property
    def finished(self) -> bool:
        """Whether the result has all pairs, and no part is left to be put into it."""
        complete = len(self._kept) == len(self.plan.pairs)
        return self._has_result and complete and not self._parts()

    @property
    def left(self) -> list[int]:
        """The pairs that are not done."""
        done = self._kept | self._where.keys()
        return [i for i in range(len(self.plan.pairs)) if i not in done]

    def _read_result(self, before: Plan) -> None:
        for index, row in enumerate(read_result(self.out, before)):
            same = self.plan.same_files((row.name1, row.name2), before.states)
            if same and row.status != FAILED:
                self._kept.add(index)
        bad = read_summary(self.out)["bad_images"]
        self._bad = {n: why for n, why in bad.items() if self.plan.same_files([n], before.states)}

    def add(self, done: Matched) -> None:
        """Put a finished block on disk."""
        self._number += 1
        path = self.folder / f"{self._number:09d}.h5"
        with replaced(path) as temporary:
            with new_file(temporary) as file:
                file["indices"] = np.array(done.indices)
                file["rows"] = np.frombuffer(self._rows_json(done), dtype=np.uint8)
                for index, found in zip(done.indices, done.matches, strict=True):
                    write_matches(file.create_group(f"pairs/{index}"), found)
            _flush(temporary)
        self._where.update(dict.fromkeys(done.indices, path))

    def assemble(self) -> dict[str, str]:
        """Write the rows and the matches of all pairs in their order; returns the bad images, the
        reason by name. Needs all pairs to be done."""
        table, matches = rows_path(self.out, self.plan), self.out / MATCHES
        bad = self._bad | dict(self.plan.bad)
        with replaced(table) as staged_table, replaced(matches) as staged_matches:
            sources = [*self._parts(), *([matches] if self._kept else [])]
            require_room(self.out / MATCHES, sum(path.stat().st_size for path in sources))
            with h5py.File(staged_matches, "w") as target:
                rows = self._rows(target, bad)
                write = write_jsonl if table.suffix == ".jsonl" else write_parquet
                write(staged_table, rows)
            _flush(staged_matches)
        return bad

    def close(self) -> None:
        """Remove the parts of a finished batch, and their folder unless it holds anything else."""
        with suppress(OSError):
            for path in self._parts():
                path.unlink()
            for left_by_kill in self.folder.glob(".*.h5.partial"):
                shutil.rmtree(left_by_kill)
            self.folder.rmdir()

    def _parts(self) -> list[Path]:
        """The parts in the folder; files of other names are none of ours."""
        if not self.folder.is_dir():
            return []
        return sorted(path for path in self.folder.iterdir() if _PART.fullmatch(path.name))

    def _rows(self, target: h5py.File, bad: dict[str, str]) -> Iterator[PairRow]:
        """The rows in the order of the pairs; their matches are copied on the way."""
        opened: OrderedDict[Path, _Part] = OrderedDict()
        with ExitStack() as stack:
            stack.callback(lambda: [part.file.close() for part in opened.values()])
            kept: Iterator[PairRow | None] = repeat(None)
            if self._kept:
                kept = read_result(self.out, self.plan)
                result = stack.enter_context(open_matches(self.out / MATCHES))
            for index, row in zip(range(len(self.plan.pairs)), kept, strict=False):
                group = group_name(*self.plan.pair(index))
                path = self._where.get(index)
                if path is None:
                    assert row is not None
                    result.copy(group, target, group)
                    yield row
                    continue
                if path not in opened:
                    if len(opened) == _OPEN_PARTS:
                        opened.popitem(last=False)[1].file.close()
                    opened[path] = _Part.open(path)
                opened.move_to_end(path)
                part = opened[path]
                bad.update({n: part.bad[n] for n in self.plan.pair(index) if n in part.bad})
                part.file.copy(f"pairs/{index}", target, group)
                yield part.rows[index]

    def _rows_json(self, done: Matched) -> bytes:
        rows = {str(i): row_data(row) for i, row in zip(done.indices, done.rows, strict=True)}
        names = {name for row in done.rows for name in (row.name1, row.name2)}
        states = {name: self.plan.states.get(name) for name in names}
        data = {"rows": rows, "bad": done.bad, "states": states}
        return json.dumps(data, allow_nan=False).encode()


@dataclass(frozen=True, eq=False)
class _Part:
    """An open part."""

    file: Any
    rows: Mapping[int, PairRow]
    bad: Mapping[str, str]
    states: Mapping[str, FileState]  # of the photographs when their pairs were matched

    @classmethod
    def open(cls, path: Path) -> _Part:
        return cls.parse(h5py.File(path, "r"), path)

    @classmethod
    def parse(cls, file: Any, path: Path) -> _Part:
        data = json.loads(np.asarray(file["rows"]).tobytes())
        rows = {int(i): parse_row(row, f"{path}: pair {i}") for i, row in data["rows"].items()}
        return cls(file, rows, data["bad"], parse_states(data["states"]))


def read_part(path: Path, plan: Plan) -> list[int]:
    """The pairs of a part that are done: matched from photographs as the plan has them, without a
    failure. Raises InputError or OSError if it is not whole."""
    if path.suffix != ".h5":
        raise InputError(f"{path}: left half-written by a kill")
    with open_matches(path) as file, read_as("a part of a batch", path):
        part = _Part.parse(file, path)
        return [
            index
            for index in np.asarray(file["indices"]).tolist()
            if part.rows[index].status != FAILED and plan.same_files(plan.pair(index), part.states)
        ]


def _flush(path: Path) -> None:
    """Bring a file to the disk before it takes its name: a machine that loses its power must not
    leave an empty one."""
    with writing(path), path.open("rb") as stream:
        os.fsync(stream.fileno())
