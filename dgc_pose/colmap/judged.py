"""Judged matches as a COLMAP database, for `colmap mapper` and pycolmap to go on from."""

import sqlite3
from contextlib import closing
from dataclasses import replace
from itertools import chain
from pathlib import Path

import numpy as np

from dgc_pose.batch.given.database import DatabaseMatches
from dgc_pose.batch.given.matches import GivenMatches, IndexedMatches, guessed_size
from dgc_pose.batch.pairs import PairRow
from dgc_pose.batch.result import Batch
from dgc_pose.cameras.formats.colmap import open_database
from dgc_pose.colmap.database import two_view_geometry, write_database, written_database
from dgc_pose.colmap.tracking import SharedMatches
from dgc_pose.errors import ArgumentName, InputError
from dgc_pose.estimation.status import CONFIGURATIONS
from dgc_pose.system.colmap_library import pycolmap

_ROOM = 2  # times the size of a database, for its copy and SQLite's log


def require_key_points(given: GivenMatches) -> IndexedMatches:
    """The source, which must have key points that its pairs share. Raises InputError."""
    if not isinstance(given, IndexedMatches):
        lacks = f"needs key points that pairs share, and the .npz of {given.path} have none"
        raise InputError(ArgumentName("out"), lacks)
    return given


def write_judged(batch: Batch, given: GivenMatches, path: Path) -> int:
    """Write a database whose two-view geometries are the poses and rotations that the folder
    accepts, with their inliers. The source's database is copied, with all its key points, matches
    and cameras; of hloc's images, those of such a pair have key points. Returns the number of
    pairs. Raises what `write_database` raises."""
    source = require_key_points(given)
    rows: dict[tuple[str, str], PairRow] = {}
    pairs: dict[tuple[str, str], np.ndarray] = {}
    for row in (pair.row for pair in batch.pairs()):
        if row.pose is not None and row.status in CONFIGURATIONS and not row.rejected:
            index, _ = source.indices(row.names)
            rows[row.names] = row
            pairs[row.names] = index[row.pose.inliers].astype(np.uint32)
    if isinstance(source, DatabaseMatches):
        _write_copy(path, source, rows, pairs)
    else:
        cameras = {
            name: camera if camera.size else replace(camera, size=guessed_size(camera))
            for name, camera in batch.plan.final_cameras.items()
        }
        names = set(chain.from_iterable(pairs))
        key_points = {name: source.key_points(name).points for name in sorted(names)}
        write_database(
            path, batch.plan.names, cameras, SharedMatches(key_points, pairs), rows.values()
        )
    return len(rows)


def _write_copy(
    path: Path,
    source: DatabaseMatches,
    rows: dict[tuple[str, str], PairRow],
    pairs: dict[tuple[str, str], np.ndarray],
) -> None:
    room = _ROOM * sum(file.stat().st_size for file in source.files()) + 2**20
    with written_database(path, room) as temporary:
        with open_database(source.path) as before, closing(sqlite3.connect(temporary)) as copy:
            before.backup(copy)
        with pycolmap.Database.open(temporary) as database:
            database.clear_two_view_geometries()
            for names, row in rows.items():
                id1, id2 = (source.ids[name] for name in names)
                geometry = two_view_geometry(row, pairs[names])
                database.write_two_view_geometry(id1, id2, geometry)
