"""The folder of a batch: finished blocks as they come, and the result when all are there.

- `plan.json`: the settings, the images with their cameras, and the pairs.
- `parts/`: a file for each finished block, which appears whole or not at all.
- `pairs.jsonl` or `pairs.parquet`, `matches.h5`, `summary.json`: the result, in the order of the
  pairs whatever the order in which they were done; the parts are removed then.
"""

from __future__ import annotations

import json
import os
import re
from collections import OrderedDict
from collections.abc import Iterator, Mapping
from contextlib import suppress
from dataclasses import dataclass
from pathlib import Path
from typing import Any, Literal, get_args

import h5py
import numpy as np

from dgc_pose.batch.calibration import camera_data, parse_camera_data
from dgc_pose.batch.matches_file import group_name, new_file, open_matches, write_matches
from dgc_pose.batch.rows import PairRow, parse_row, row_data, write_jsonl, write_parquet
from dgc_pose.batch.work import Matched
from dgc_pose.camera import Camera
from dgc_pose.errors import InputError, reason
from dgc_pose.files import replaced, require_room, write_text
from dgc_pose.inputs import read_as, read_json

RowFormat = Literal["jsonl", "parquet"]
PLAN, SUMMARY, MATCHES, PARTS = "plan.json", "summary.json", "matches.h5", "parts"
_VERSION = 1
_PART = re.compile(r"(\.?)\d{9,}\.h5(\..*\.partial)?")  # also one that a kill left half-written
_OPEN_PARTS = 64  # while the result is put together


@dataclass(frozen=True)
class Plan:
    """What a batch works through."""

    root: Path  # of the image names
    cameras: Mapping[str, Camera]  # by name, with the image's size; absent for bad images
    bad: Mapping[str, str]  # the reason by name, of images that are not matched
    guessed: frozenset[str]  # images with a guessed focal length
    names: tuple[str, ...]
    pairs: np.ndarray  # (P, 2) int64, indices of `names`
    settings: Mapping[str, Any]  # all that the result depends on besides; JSON

    def pair(self, index: int) -> tuple[str, str]:
        """The names of a pair."""
        first, second = self.pairs[index]
        return self.names[first], self.names[second]


def write_plan(out: Path, plan: Plan) -> None:
    """Write `plan.json`, making the folder. Raises InputError if two pairs would share a group of
    the matches file."""
    groups: dict[str, tuple[str, str]] = {}
    for index in range(len(plan.pairs)):
        pair = plan.pair(index)
        other = groups.setdefault(group_name(*pair), pair)
        if other != pair:
            raise InputError(f"{' '.join(pair)} and {' '.join(other)} have one name in HDF5")
    out.mkdir(parents=True, exist_ok=True)
    data = {
        "version": _VERSION,
        "root": str(plan.root.resolve()),
        "settings": dict(plan.settings),
        "images": [
            {
                "name": name,
                "camera": camera_data(plan.cameras[name]) if name in plan.cameras else None,
                "bad": plan.bad.get(name),
                "guessed_focal": name in plan.guessed,
            }
            for name in plan.names
        ],
        "pairs": plan.pairs.tolist(),
    }
    write_text(out / PLAN, json.dumps(data, allow_nan=False) + "\n")


def read_plan(out: Path) -> Plan:
    """The plan of a folder. Raises InputError, with the path, if there is none or it is broken."""
    path = out / PLAN
    if not path.is_file():
        raise InputError(f"{out}: no folder of `dgc-pose batch` (it has no {PLAN})")
    data = read_json(path, "the plan of a batch")
    try:
        images = data["images"]
        if data["settings"]["format"] not in get_args(RowFormat):
            raise ValueError("a format of rows that is none")
        plan = Plan(
            Path(data["root"]),
            {
                one["name"]: parse_camera_data(one["camera"])
                for one in images
                if one["camera"] is not None
            },
            {one["name"]: one["bad"] for one in images if one["bad"] is not None},
            frozenset(one["name"] for one in images if one["guessed_focal"]),
            tuple(one["name"] for one in images),
            np.array(data["pairs"], dtype=np.int64).reshape(-1, 2),
            data["settings"],
        )
        if not all(isinstance(name, str) for name in (*plan.names, *plan.bad.values())):
            raise ValueError("names that are no texts")
        if len(plan.pairs) and not 0 <= plan.pairs.min() <= plan.pairs.max() < len(plan.names):
            raise ValueError("pairs of images that are not listed")
        return plan
    except (ValueError, KeyError, TypeError, AttributeError, IndexError, OverflowError) as error:
        raise InputError(f"{path}: not the plan of a batch ({reason(error)})") from None


def require_same(plan: Plan, settings: Mapping[str, Any], out: Path) -> None:
    """Raise InputError, naming the setting, if a batch to be resumed had others."""
    for key, value in json.loads(json.dumps(settings)).items():
        if plan.settings.get(key) != value:
            raise InputError(
                f"{out / PLAN}: that batch had {key} {json.dumps(plan.settings.get(key))}, not "
                f"{json.dumps(value)}: --resume needs the same options"
            )


def rows_path(out: Path, plan: Plan) -> Path:
    """The table of the rows."""
    return out / f"pairs.{plan.settings['format']}"


class PartStore:
    """The finished blocks of a batch."""

    def __init__(self, out: Path, plan: Plan) -> None:
        """Reads which pairs are done; a part that cannot be read is removed, and counts as not
        done."""
        self.out = out
        self.plan = plan
        self.folder = out / PARTS
        self._where: dict[int, Path] = {}  # the part of each pair that is done
        self.finished = (out / SUMMARY).is_file()
        if self.finished:
            self.close()
            return
        self.folder.mkdir(exist_ok=True)
        for path in self._parts():
            try:
                indices = read_part(path)
            except (InputError, OSError):
                path.unlink()
                continue
            self._where.update(dict.fromkeys(indices, path))

    @property
    def left(self) -> list[int]:
        """The pairs that are not done."""
        if self.finished:
            return []
        return [i for i in range(len(self.plan.pairs)) if i not in self._where]

    def add(self, done: Matched) -> None:
        """Put a finished block on disk."""
        path = self.folder / f"{done.indices[0]:09d}.h5"
        with replaced(path) as temporary:
            with new_file(temporary) as file:
                file["indices"] = np.array(done.indices)
                file["rows"] = np.frombuffer(_rows_json(done), dtype=np.uint8)
                for index, found in zip(done.indices, done.matches, strict=True):
                    write_matches(file.create_group(f"pairs/{index}"), found)
            _flush(temporary)
        self._where.update(dict.fromkeys(done.indices, path))

    def assemble(self) -> dict[str, str]:
        """Write the rows and the matches of all pairs in their order; returns the bad images, the
        reason by name. Needs all pairs to be done."""
        table, matches = rows_path(self.out, self.plan), self.out / MATCHES
        bad = dict(self.plan.bad)
        with replaced(table) as staged_table, replaced(matches) as staged_matches:
            size = sum(part.stat().st_size for part in self._parts())
            require_room(self.out / MATCHES, size + 2**20)
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
            self.folder.rmdir()

    def _parts(self) -> list[Path]:
        """The parts in the folder; files of other names are none of ours."""
        if not self.folder.is_dir():
            return []
        return sorted(path for path in self.folder.iterdir() if _PART.fullmatch(path.name))

    def _rows(self, target: h5py.File, bad: dict[str, str]) -> Iterator[PairRow]:
        """The rows in the order of the pairs; their matches are copied on the way."""
        opened: OrderedDict[Path, _Part] = OrderedDict()
        try:
            for index in range(len(self.plan.pairs)):
                path = self._where[index]
                if path not in opened:
                    if len(opened) == _OPEN_PARTS:
                        opened.popitem(last=False)[1].file.close()
                    opened[path] = _Part.open(path)
                opened.move_to_end(path)
                part = opened[path]
                bad.update(part.bad)
                part.file.copy(f"pairs/{index}", target, group_name(*self.plan.pair(index)))
                yield part.rows[index]
        finally:
            for part in opened.values():
                part.file.close()


@dataclass(frozen=True, eq=False)
class _Part:
    """An open part."""

    file: Any
    rows: Mapping[int, PairRow]
    bad: Mapping[str, str]

    @classmethod
    def open(cls, path: Path) -> _Part:
        file = h5py.File(path, "r")
        return cls(file, *_parse_rows(file, path))


def read_part(path: Path) -> list[int]:
    """The pairs of a part. Raises InputError or OSError if it is not whole."""
    if path.suffix != ".h5":
        raise InputError(f"{path}: left half-written by a kill")
    with open_matches(path) as file, read_as("a part of a batch", path):
        indices: list[int] = np.asarray(file["indices"]).tolist()
        _parse_rows(file, path)
    return indices


def _rows_json(done: Matched) -> bytes:
    rows = {str(i): row_data(row) for i, row in zip(done.indices, done.rows, strict=True)}
    return json.dumps({"rows": rows, "bad": done.bad}, allow_nan=False).encode()


def _parse_rows(file: Any, path: Path) -> tuple[dict[int, PairRow], dict[str, str]]:
    data = json.loads(np.asarray(file["rows"]).tobytes())
    rows = {int(i): parse_row(row, f"{path}: pair {i}") for i, row in data["rows"].items()}
    return rows, data["bad"]


def _flush(path: Path) -> None:
    """Bring a file to the disk before it takes its name: a machine that loses its power must not
    leave an empty one."""
    with path.open("rb") as stream:
        os.fsync(stream.fileno())
