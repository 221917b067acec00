"""The store of a batch, `batch.db`: its plan, its matched pairs and its result.

It is an SQLite database: a kill at any moment leaves each change complete or undone. It holds for
each pair a row of JSON and two .npz archives: the arrays of the pose, and the matches in float32.
"""

import errno
import io
import json
import math
import sqlite3
from collections.abc import Collection, Iterator, Mapping
from contextlib import closing, contextmanager
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any, Literal

import numpy as np

from dgc_pose.batch.pairs import MatchedPair, PairRow, parse_row
from dgc_pose.batch.source import STORE, FileState
from dgc_pose.cameras.calibration import camera_data, parse_camera_data
from dgc_pose.cameras.camera import Camera
from dgc_pose.errors import ArgumentName, InputError, shortened
from dgc_pose.matches import Matches
from dgc_pose.system.arrays import unpacked
from dgc_pose.system.files import read_as

_VERSION = 9
_FITTED_CAMERA_FIELDS = ("K", "focal_std", "focal_source")
_RESUME = ArgumentName("resume")
_TABLES = (
    "facts (name TEXT PRIMARY KEY, value TEXT)",
    "matched (pair INTEGER PRIMARY KEY, row TEXT, pose BLOB, matches BLOB)",  # each pair on its own
    # Poses by the folder's cameras; `matches` is NULL if they equal those of `matched`.
    "result (pair INTEGER PRIMARY KEY, row TEXT, pose BLOB, matches BLOB)",
)
_ADD = {
    "matched": "INSERT OR REPLACE INTO matched VALUES (?, ?, ?, ?)",
    "result": "INSERT INTO result SELECT ?1, ?2, ?3, NULLIF(?4, matches) FROM matched "
    "WHERE pair = ?1",
}
_WHAT = "the store of a batch"
_FIELDS = ("points1", "points2", "confidence")
Table = Literal["matched", "result"]


@dataclass(frozen=True)
class Plan:
    """The work of a batch."""

    root: Path  # folder that the image names are relative to
    cameras: Mapping[str, Camera]  # by name, with the image's size; absent for bad images
    bad: Mapping[str, str]  # by name, why an image is not matched
    states: Mapping[str, FileState]  # of the photographs' files, by name
    names: tuple[str, ...]
    pairs: np.ndarray  # (P, 2) int64, indices of `names`
    # Everything else that the result depends on, and the `command` of the batch; values of JSON.
    # `second` is the fingerprint of the second matcher: None without one, `MISSING` if it is not
    # installed. A batch may be resumed with another one.
    settings: Mapping[str, Any]
    # The cameras pooled from all pairs; None before the result, and if all cameras are exact
    pooled: Mapping[str, Camera] | None = None

    @property
    def uncertain(self) -> bool:
        """Whether any camera parameter is estimated from the pairs."""
        return any(not camera.exact for camera in self.cameras.values())

    @property
    def final_cameras(self) -> Mapping[str, Camera]:
        """The cameras of the poses in the result."""
        return {**self.cameras, **(self.pooled or {})}

    def pair(self, index: int) -> tuple[str, str]:
        """The names of a pair."""
        first, second = self.pairs[index]
        return self.names[first], self.names[second]


def plan_data(plan: Plan) -> dict[str, Any]:
    """A plan as values of JSON."""
    cameras, pooled = (
        {name: camera_data(camera) for name, camera in (known or {}).items()}
        for known in (plan.cameras, plan.pooled)
    )
    return {
        "version": _VERSION,
        "root": str(plan.root.resolve()),
        "settings": dict(plan.settings),
        "names": plan.names,
        "cameras": cameras,
        "pooled": pooled,
        "bad": dict(plan.bad),
        "states": dict(plan.states),
        "pairs": plan.pairs.tolist(),
    }


def parse_plan(data: Mapping[str, Any]) -> Plan:
    """The plan of `plan_data`. Other data may raise any exception."""
    if data["version"] != _VERSION:
        raise ValueError(f"of version {data['version']}, and this is version {_VERSION}")
    cameras, pooled = (
        {name: parse_camera_data(values) for name, values in data[key].items()}
        for key in ("cameras", "pooled")
    )
    plan = Plan(
        Path(data["root"]),
        cameras,
        dict(data["bad"]),
        {name: tuple(map(int, state)) for name, state in data["states"].items()},
        tuple(map(str, data["names"])),
        np.array(data["pairs"], dtype=np.int64).reshape(-1, 2),
        dict(data["settings"]),
        pooled or None,
    )
    if len(plan.pairs) and not 0 <= plan.pairs.min() <= plan.pairs.max() < len(plan.names):
        raise ValueError("pairs of images that are not listed")
    return plan


def continued(before: Plan, now: Plan, out: Path) -> Plan:
    """The plan `now` with the pairs of the batch `before`, to resume that batch in `out`.

    Raises InputError if `before` had other images, settings or pairs, or other cameras of unchanged
    photographs. Changed photographs may have other cameras.
    """
    changed = sorted({*now.names} ^ {*before.names})
    if changed and now.root == before.root:
        name = changed[0]
        what = "is new since that batch" if name in now.names else "has gone since that batch"
        if name in before.bad and name in now.names:
            what = f"could not be read by that batch ({before.bad[name]})"
        elif name in now.bad:
            what = f"was read by that batch and cannot be read now ({now.bad[name]})"
        raise InputError(f"{now.root / name} {what}:", _RESUME, "needs the same")
    unchanged = [n for n in now.names if now.states.get(n) == before.states.get(n)]
    old, new = (_facts(plan, unchanged, pairs=len(now.pairs) > 0) for plan in (before, now))
    if old != new:
        command = shortened(before.settings.get("command", "another version"))
        other = f"has another folder, options, pairs or cameras (`{command}`):"
        raise InputError(f"{out / STORE} {other}", _RESUME, "needs the same")
    bad = {name: before.bad[name] for name in unchanged if name in before.bad}
    command = before.settings.get("command", now.settings.get("command"))
    settings = {**now.settings, "command": command}
    return replace(
        now, names=before.names, pairs=before.pairs, bad=bad | dict(now.bad), settings=settings
    )


def _facts(plan: Plan, names: Collection[str], *, pairs: bool) -> Any:
    """The facts that must be equal to resume a batch. names: images whose cameras are compared;
    pairs: whether the pairs are compared."""
    cameras = []
    for data in (camera_data(plan.cameras[name]) for name in names if name in plan.cameras):
        # Without a given K, the photographs determine the camera, and the lines of one affect all.
        open_ = _FITTED_CAMERA_FIELDS if data["focal_source"] != "given" else ()
        cameras.append({k: v for k, v in data.items() if k not in ("warnings", *open_)})
    settings = {k: v for k, v in plan.settings.items() if k not in ("command", "second")}
    named = [plan.pair(i) for i in range(len(plan.pairs))] if pairs else []
    return json.loads(json.dumps([str(plan.root), settings, named, cameras]))


@contextmanager
def open_store(out: Path, *, create: bool = False) -> Iterator["BatchStore"]:
    """The store in a folder. Raises InputError, with the path, if it is missing and `create` is
    False."""
    path = out / STORE
    uri = f"{path.resolve().as_uri()}?mode={'rwc' if create else 'rw'}"
    with read_as(_WHAT, path):
        database = sqlite3.connect(uri, uri=True, isolation_level=None)
    with closing(database):
        yield BatchStore(path, database)


class BatchStore:
    """The pairs of a batch. Reading a broken file raises InputError, with the path; a failed write
    raises OSError."""

    def __init__(self, path: Path, database: sqlite3.Connection) -> None:
        self._path = path
        self._database = database

    @contextmanager
    def change(self) -> Iterator[None]:
        """A transaction: after an error or a kill, none of its writes remains."""
        try:
            with self._database:
                self._database.execute("BEGIN IMMEDIATE")
                yield
        except sqlite3.DatabaseError as error:
            raise OSError(errno.EIO, f"SQLite: {error}", str(self._path)) from None

    def begin(self, plan: Plan, again: Collection[int] = ()) -> None:
        """Store the plan, and remove any result and the pairs to match again."""
        with self.change():
            for table in _TABLES:
                self._database.execute(f"CREATE TABLE IF NOT EXISTS {table}")
            self._database.execute("DELETE FROM result")
            self._database.execute("DELETE FROM facts")
            self._database.executemany("DELETE FROM matched WHERE pair = ?", zip(again))
            self._put_fact("plan", plan_data(plan))

    def finish(self, plan: Plan, summary: Mapping[str, Any]) -> None:
        """Store the plan with the cameras of the result, and the summary, within a `change`."""
        self._put_fact("plan", plan_data(plan))
        self._put_fact("summary", summary)

    def add(self, table: Table, pairs: Collection[MatchedPair]) -> None:
        """Store pairs, within a `change`. Pairs of "result" must be in "matched" already."""
        for pair in pairs:
            row = pair.row
            pose = pair.row.pose
            pose_arrays = {} if pose is None else {"inliers": pose.inliers}
            if pose is not None and pose.camera_covariance is not None:
                pose_arrays["camera_covariance"] = pose.camera_covariance
            values = row.index, row.to_json(), _packed(pose_arrays), _packed(_arrays(pair))
            self._database.execute(_ADD[table], values)

    def rewrite(self, rows: Collection[PairRow]) -> None:
        """Replace rows of the result, within a `change`."""
        values = ((row.to_json(), row.index) for row in rows)
        self._database.executemany("UPDATE result SET row = ? WHERE pair = ?", values)

    @property
    def plan(self) -> Plan | None:
        """The plan; None if a kill came before it was stored."""
        with read_as(_WHAT, self._path):
            data = self._fact("plan")
            return None if data is None else parse_plan(data)

    @property
    def summary(self) -> Mapping[str, Any] | None:
        """The summary of the result; None without a result."""
        with read_as(_WHAT, self._path):
            data = self._fact("summary")
            return None if data is None else dict(data)

    def rows(self, table: Table) -> list[PairRow]:
        """The rows of a table in the order of the pairs."""
        return [parse_row(text, pair, self._where(pair)) for pair, text in self.lines(table)]

    def lines(self, table: Table) -> list[tuple[int, str]]:
        """The index of each pair and its row as JSON, in the order of the pairs."""
        with read_as(_WHAT, self._path):
            return list(self._database.execute(f"SELECT pair, row FROM {table} ORDER BY pair"))

    def indices(self, table: Table) -> list[int]:
        """The indices of the pairs of a table, in ascending order."""
        with read_as(_WHAT, self._path):
            found = self._database.execute(f"SELECT pair FROM {table} ORDER BY pair")
            return [pair for (pair,) in found]

    def pairs(self, table: Table, only: Collection[int] | None = None) -> Iterator[MatchedPair]:
        """Yield the pairs of a table in ascending order. only: indices of some pairs."""
        for index in self.indices(table) if only is None else sorted(only):
            yield self._pair(table, index)

    def byte_count(self) -> int:
        """Size of the matches, bytes."""
        with read_as(_WHAT, self._path):
            counts = self._database.execute("SELECT SUM(LENGTH(matches)) FROM matched")
            return counts.fetchone()[0] or 0

    def _pair(self, table: Table, index: int) -> MatchedPair:
        with read_as(_WHAT, self._path):
            found = self._database.execute(
                f"SELECT t.row, t.pose, COALESCE(t.matches, m.matches) FROM {table} t "
                "LEFT JOIN matched m USING (pair) WHERE pair = ?",
                (index,),
            )
            text, *packed = found.fetchone()
            row = parse_row(text, index, self._where(index))
            pose_arrays, arrays = (unpacked(data, self._where(index)) for data in packed)
            error_px, key_points, map_error_px, around = arrays["facts"].tolist()
            points1, points2, confidence = (arrays[name] for name in _FIELDS)
            matches = Matches(points1, points2, confidence, error_px, bool(key_points))
            if not math.isnan(around):
                matches = replace(matches, context_ratio=around)
            sample = None
            if map_error_px:
                points1, points2, confidence = (arrays[f"map_{name}"] for name in _FIELDS)
                sample = Matches(points1, points2, confidence, map_error_px)
            if row.pose is not None:
                inliers = pose_arrays["inliers"]
                covariance = pose_arrays.get("camera_covariance")
                pose = replace(row.pose, inliers=inliers, camera_covariance=covariance)
                row = replace(row, pose=pose)
            return MatchedPair(row, matches, sample)

    def _where(self, index: int) -> str:
        return f"{self._path}: pair {index + 1}"

    def _put_fact(self, name: str, value: Mapping[str, Any]) -> None:
        text = json.dumps(value, allow_nan=False)
        self._database.execute("INSERT OR REPLACE INTO facts VALUES (?, ?)", (name, text))

    def _fact(self, name: str) -> Any:
        kinds = {kind for (kind,) in self._database.execute("SELECT type FROM sqlite_master")}
        if not kinds:
            return None
        if kinds & {"view", "trigger"}:  # reading one might never end
            raise ValueError("a view or a trigger")
        found = self._database.execute("SELECT value FROM facts WHERE name = ?", (name,)).fetchone()
        return None if found is None else json.loads(found[0])


def _arrays(pair: MatchedPair) -> dict[str, np.ndarray]:
    matches = pair.matches
    sample = pair.map_matches
    arrays = {name: getattr(matches, name).astype(np.float32) for name in _FIELDS}
    if sample is not None:
        arrays |= {f"map_{name}": getattr(sample, name).astype(np.float32) for name in _FIELDS}
    map_error_px = 0.0 if sample is None else sample.error_px
    around = math.nan if matches.context_ratio is None else matches.context_ratio
    facts = matches.error_px, matches.key_points, map_error_px, around
    return {**arrays, "facts": np.array(facts)}


def _packed(arrays: Mapping[str, np.ndarray]) -> bytes:
    file = io.BytesIO()
    np.savez(file, **arrays)  # type: ignore[arg-type]
    return file.getvalue()
