"""The folder of a batch: finished blocks as they come, and the result when all are there.

- `plan.json`: see `plan`.
- `parts/`: a file for each finished block, which appears whole or not at all.
- `estimates/`: the same of pairs whose poses are estimated again, with pooled cameras.
- `cameras.csv`: the pooled cameras, see `pooling`.
- `pairs.jsonl` or `pairs.parquet`, `matches.h5`, `summary.json`: the result, in the order of the
  pairs whatever the order in which they were done; the parts are removed then.
"""

import json
import re
import shutil
from collections.abc import Iterator, Mapping, Sequence
from contextlib import ExitStack, suppress
from dataclasses import asdict, dataclass
from functools import lru_cache
from itertools import islice, repeat
from pathlib import Path
from typing import Any

import h5py
import numpy as np

from dgc_pose.batch.matches_file import (
    PairMatches,
    group_name,
    new_file,
    open_matches,
    read_matches,
    write_matches,
)
from dgc_pose.batch.plan import Plan, parse_states
from dgc_pose.batch.rows import (
    FAILED,
    PairRow,
    parse_row,
    read_rows,
    write_jsonl,
    write_parquet,
)
from dgc_pose.batch.source import FileState
from dgc_pose.batch.work import Matched
from dgc_pose.errors import InputError
from dgc_pose.files.inputs import read_as
from dgc_pose.files.json_files import read_json
from dgc_pose.files.outputs import replaced, require_room

SUMMARY, MATCHES, PARTS, ESTIMATES = "summary.json", "matches.h5", "parts", "estimates"
_PART = re.compile(r"\d{9,}\.h5")
_PARTS_HELD = 16  # in memory, while the result is put together
_SUMMARY: Mapping[str, type | tuple[type, ...]] = {  # what is read again
    **dict.fromkeys(("images", "pairs", "poses", "matched_now"), int),
    **dict.fromkeys(("bad_images", "by_status"), dict),
    "cameras": list,
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

    def __init__(
        self, out: Path, plan: Plan, before: Plan | None = None, folder: str = PARTS
    ) -> None:
        """Reads which pairs are done: in a part, or in the result of the plan `before`, by
        photographs that have not changed since, and without a failure. A part that cannot be read
        is removed."""
        self.out = out
        self.plan = plan
        self.folder = out / folder
        self.bad = dict(plan.bad)  # of all pairs that are done, the reason by image
        self._part_of: dict[int, Path] = {}  # by pair, the last part that has it
        self._in_result: set[int] = set()  # pairs that are done in the result
        self._number = -1  # of the last part
        self._has_result = before is not None and (out / SUMMARY).is_file()
        if before is not None and self._has_result:
            self._read_result(before)
        self.folder.mkdir(exist_ok=True)
        for path in self._parts():
            try:
                part = read_part(path)
            except (InputError, OSError):
                path.unlink()
                continue
            self._hold(path, part.done(plan), part.bad)
            self._number = int(path.stem)

    @property
    def finished(self) -> bool:
        """Whether the result has all pairs, and no part is left to be put into it."""
        complete = len(self._in_result) == len(self.plan.pairs)
        return self._has_result and complete and not self._parts()

    @property
    def left(self) -> list[int]:
        """The pairs that are not done."""
        done = self._in_result | self._part_of.keys()
        return [i for i in range(len(self.plan.pairs)) if i not in done]

    @property
    def result_alone(self) -> set[int]:
        """The pairs that are done in the result, and in no part."""
        return self._in_result - self._part_of.keys()

    def blocks(self) -> Iterator[Matched]:
        """The pairs in the parts, a block for each part."""
        for path, pairs in self._pairs_of_parts():
            part = read_part(path, matches=True)
            rows = [part.rows[pair] for pair in pairs]
            yield Matched(tuple(pairs), rows, [part.matches[pair] for pair in pairs], {})

    def result_blocks(self, before: Plan, size: int) -> Iterator[Matched]:
        """The pairs of `result_alone` in blocks. before: the plan of the result."""
        alone = self.result_alone
        with ExitStack() as stack:
            if alone:
                result = stack.enter_context(open_matches(self.out / MATCHES))
            rows = enumerate(read_result(self.out, before)) if alone else iter(())
            chosen = ((pair, row) for pair, row in rows if pair in alone)
            while block := list(islice(chosen, size)):
                matches = [
                    read_matches(result, group_name(row.name1, row.name2)) for _, row in block
                ]
                yield Matched(
                    tuple(pair for pair, _ in block), [row for _, row in block], matches, {}
                )

    def add(self, done: Matched) -> None:
        """Put a finished block on disk."""
        self._number += 1
        path = self.folder / f"{self._number:09d}.h5"
        names = {name for row in done.rows for name in (row.name1, row.name2)}
        data = {
            "rows": dict(zip(done.indices, map(asdict, done.rows), strict=True)),
            "bad": done.bad,
            "states": {name: self.plan.states.get(name) for name in names},
        }
        with replaced(path) as temporary, new_file(temporary) as file:
            text = json.dumps(data, allow_nan=False)
            file["rows"] = np.frombuffer(text.encode(), dtype=np.uint8)
            for index, matches in zip(done.indices, done.matches, strict=True):
                write_matches(file.create_group(f"pairs/{index}"), matches)
        self._hold(path, done.indices, done.bad)

    def assemble(self) -> None:
        """Write the rows and the matches of all pairs in their order. Needs all to be done."""
        table, matches = rows_path(self.out, self.plan), self.out / MATCHES
        with replaced(table) as staged_table, replaced(matches) as staged_matches:
            sources = [*self._parts(), *([matches] if self._in_result else [])]
            require_room(matches, sum(path.stat().st_size for path in sources))
            with h5py.File(staged_matches, "w") as target:
                write = write_jsonl if table.suffix == ".jsonl" else write_parquet
                write(staged_table, self._rows(target))

    def close(self) -> None:
        """Remove the parts of a finished batch, and their folder unless it holds anything else."""
        with suppress(OSError):
            for path in self._parts():
                path.unlink()
            for left_by_kill in self.folder.glob(".*.h5.partial"):
                shutil.rmtree(left_by_kill)
            self.folder.rmdir()

    def _read_result(self, before: Plan) -> None:
        for index, row in enumerate(read_result(self.out, before)):
            unchanged = self.plan.same_files((row.name1, row.name2), before.states)
            if unchanged and row.status != FAILED:
                self._in_result.add(index)
        for name, reason in read_summary(self.out)["bad_images"].items():
            if self.plan.same_files([name], before.states):
                self.bad.setdefault(name, reason)

    def _hold(self, path: Path, pairs: Sequence[int], bad: Mapping[str, str]) -> None:
        self._part_of.update(dict.fromkeys(pairs, path))
        names = {name for index in pairs for name in self.plan.pair(index)}
        self.bad.update({name: bad[name] for name in names & bad.keys()})

    def _pairs_of_parts(self) -> list[tuple[Path, list[int]]]:
        """The parts with the pairs that each is the last to have."""
        pairs: dict[Path, list[int]] = {}
        for pair, path in sorted(self._part_of.items()):
            pairs.setdefault(path, []).append(pair)
        return sorted(pairs.items())

    def _parts(self) -> list[Path]:
        """The parts in the folder; files of other names are none of ours."""
        return sorted(path for path in self.folder.glob("*.h5") if _PART.fullmatch(path.name))

    def _rows(self, target: h5py.File) -> Iterator[PairRow]:
        """The rows in the order of the pairs; their matches are written on the way."""
        part_at = lru_cache(_PARTS_HELD)(lambda path: read_part(path, matches=True))
        with ExitStack() as stack:
            rows: Iterator[PairRow | None] = repeat(None)
            if self._in_result:
                rows = read_result(self.out, self.plan)
                result = stack.enter_context(open_matches(self.out / MATCHES))
            for index, row in zip(range(len(self.plan.pairs)), rows, strict=False):
                group = group_name(*self.plan.pair(index))
                if index in self._part_of:
                    part = part_at(self._part_of[index])
                    row, matches = part.rows[index], part.matches[index]
                else:
                    matches = read_matches(result, group)
                write_matches(target.create_group(group), matches)
                assert row is not None
                yield row


@dataclass(frozen=True, eq=False)
class Part:
    """A finished block."""

    rows: Mapping[int, PairRow]  # by pair
    matches: Mapping[int, PairMatches]
    bad: Mapping[str, str]  # the reason by image
    states: Mapping[str, FileState]  # of the photographs when their pairs were matched

    def done(self, plan: Plan) -> list[int]:
        """The pairs matched from photographs as the plan has them, without a failure."""
        return [
            pair
            for pair, row in self.rows.items()
            if 0 <= pair < len(plan.pairs)
            and row.status != FAILED
            and plan.same_files(plan.pair(pair), self.states)
        ]


def read_part(path: Path, *, matches: bool = False) -> Part:
    """The rows of a part, and its matches if they are asked for. Raises InputError or OSError if it
    is not whole."""
    with open_matches(path) as file, read_as("a part of a batch", path):
        data = json.loads(np.asarray(file["rows"]).tobytes())
        rows = {
            int(pair): parse_row(values, f"{path}: pair {pair}")
            for pair, values in data["rows"].items()
        }
        arrays = {pair: read_matches(file, f"pairs/{pair}") for pair in rows if matches}
        return Part(rows, arrays, dict(data["bad"]), parse_states(data["states"]))
