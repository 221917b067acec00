"""The pairs of a batch that are matched, in two files that grow: `matched.jsonl`, `matched.bin`.

A line of the first is the row of a pair, with the place of its matches in the second. It is
written after them, so a kill leaves every line with its matches, but for a last one cut short.
"""

import json
from collections.abc import Collection, Iterator, Mapping
from dataclasses import asdict, dataclass
from pathlib import Path

from dgc_pose.batch.matches_file import pack, unpack
from dgc_pose.batch.plan import Plan, parse_states
from dgc_pose.batch.rows import FAILED, PairRow, parse_row
from dgc_pose.batch.schedule import BLOCK, blocks_of
from dgc_pose.batch.work import Matched
from dgc_pose.errors import InputError
from dgc_pose.files.inputs import open_regular, read_as
from dgc_pose.files.outputs import writing


@dataclass(frozen=True, eq=False)
class _Done:
    """A pair that is done."""

    row: PairRow
    bad: Mapping[str, str]  # of its images that could not be read: the reason by name
    start: int  # of its matches, bytes
    length: int


class PairStore:
    """The pairs that are done. Raises InputError, with the path, for lines of another kind."""

    def __init__(self, out: Path, plan: Plan) -> None:
        """Reads the pairs that are done, by photographs as the plan has them, without a failure."""
        self._plan = plan
        self._lines, self._matches = out / "matched.jsonl", out / "matched.bin"
        self._done: dict[int, _Done] = {}
        self._whole = 0  # bytes of the lines without one that a kill cut short
        if self._lines.exists():
            self._read()

    def __len__(self) -> int:
        return len(self._done)

    @property
    def left(self) -> list[int]:
        """The pairs that are not done."""
        return [index for index in range(len(self._plan.pairs)) if index not in self._done]

    @property
    def rows(self) -> list[PairRow]:
        """The rows of the pairs that are done, in their order."""
        return [self._done[index].row for index in sorted(self._done)]

    @property
    def bad(self) -> dict[str, str]:
        """The reasons of all images that cannot be used, by name."""
        reasons = dict(self._plan.bad)
        for done in self._done.values():
            reasons.update(done.bad)
        return reasons

    @property
    def byte_count(self) -> int:
        """Size of the matches, bytes."""
        return self._matches.stat().st_size if self._matches.exists() else 0

    def add(self, block: Matched) -> None:
        """Put the pairs of a block on disk."""
        lines = []
        with writing(self._matches), self._matches.open("ab") as file:
            for index, row, matches in zip(block.indices, block.rows, block.matches, strict=True):
                packed = pack(matches)
                bad = {name: block.bad[name] for name in row.names if name in block.bad}
                done = _Done(row, bad, file.tell(), len(packed))
                file.write(packed)
                states = {name: self._plan.states.get(name) for name in row.names}
                data = {"pair": index, "states": states, **asdict(done)}
                lines.append(json.dumps(data, allow_nan=False) + "\n")
                self._done[index] = done
        with writing(self._lines), self._lines.open("ab") as stream:
            stream.truncate(self._whole)
            stream.write("".join(lines).encode())
            self._whole = stream.tell()

    def blocks(self, size: int = BLOCK, only: Collection[int] | None = None) -> Iterator[Matched]:
        """The pairs that are done, in their order, so many at a time; only: the indices of some."""
        for block in blocks_of(sorted(self._done if only is None else only), size):
            matches = []
            with open_regular(self._matches) as file:
                for index in block:
                    done = self._done[index]
                    file.seek(done.start)
                    matches.append(unpack(file.read(done.length), f"{self._matches}: pair {index}"))
            yield Matched(tuple(block), [self._done[index].row for index in block], matches, {})

    def remove(self) -> None:
        """Remove the files."""
        for path in (self._lines, self._matches):
            path.unlink(missing_ok=True)
        self._done.clear()
        self._whole = 0

    def _read(self) -> None:
        byte_count = self.byte_count
        with read_as("the pairs that a batch has done", self._lines):
            with open_regular(self._lines) as stream:
                for number, line in enumerate(stream, start=1):
                    if line.endswith(b"\n"):
                        self._whole += len(line)
                        self._hold(line, f"{self._lines}:{number}", byte_count)

    def _hold(self, line: bytes, where: str, byte_count: int) -> None:
        """Take a pair that need not be done again. Raises anything for another line."""
        data = json.loads(line)
        pair, start, length = (int(data[key]) for key in ("pair", "start", "length"))
        row, states = parse_row(data["row"], where), parse_states(data["states"])
        if not (0 <= pair < len(self._plan.pairs) and start >= 0 and length >= 0):
            raise InputError(f"{where}: numbers out of range")
        if (
            row.status != FAILED
            and start + length <= byte_count
            and self._plan.same_files(self._plan.pair(pair), states)
        ):
            self._done[pair] = _Done(row, dict(data["bad"]), start, length)
