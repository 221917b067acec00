"""Matches of a COLMAP database."""

from collections.abc import Mapping
from dataclasses import dataclass, field
from pathlib import Path

import numpy as np

from dgc_pose.batch.given.matches import IndexedMatches, KeyPoints, Names
from dgc_pose.cameras.formats.colmap import (
    Table,
    database_files,
    open_database,
    read_images,
    read_pairs,
)

_HALF_PIXEL = 0.5  # COLMAP's centre of the first pixel


@dataclass(frozen=True)
class DatabaseMatches(IndexedMatches):
    """The matches of a COLMAP database; if it has none, the inliers of its geometries."""

    ids: Mapping[str, int] = field(default_factory=dict)  # of the images
    table: Table = "matches"

    def files(self) -> list[Path]:
        return database_files(self.path)

    def key_points(self, name: str) -> KeyPoints:
        with open_database(self.path) as database:
            found = database.execute(
                "SELECT rows, cols, data FROM keypoints WHERE image_id = ?", (self.ids[name],)
            ).fetchone()
            rows, columns, data = found or (0, 2, b"")
            points = np.frombuffer(data or b"", "<f4").reshape(rows, columns)
        return KeyPoints(points[:, :2].astype(np.float64) - _HALF_PIXEL)

    def indices(self, names: Names) -> tuple[np.ndarray, np.ndarray]:
        with open_database(self.path) as database:
            rows, data = database.execute(
                f"SELECT rows, data FROM {self.table} WHERE pair_id = ?", (self.places[names],)
            ).fetchone()
            index = np.frombuffer(data, "<u4").reshape(rows, 2).astype(np.int64)
        return index, np.ones(len(index))


def read_database(path: Path) -> DatabaseMatches:
    """The images and pairs of a COLMAP database. Raises InputError, with the path, if it is none or
    has no matches; OSError if it cannot be read."""
    table: Table = "matches"
    with open_database(path) as database:
        ids, sizes, cameras = read_images(database)
        database.execute("SELECT image_id, rows, cols, data FROM keypoints LIMIT 0")
        pairs = read_pairs(database, ids, table)
        notes = [
            f"{path}: COLMAP's key points, whose first pixel has its centre at (0.5, 0.5): 0.5 "
            "is subtracted"
        ]
        if not pairs:
            table = "two_view_geometries"
            pairs = read_pairs(database, ids, table)
            notes.append("no matches, but two-view geometries: their inliers are judged")
        if not pairs:
            raise ValueError("it has no matches")
    places = {names: str(key) for names, key in pairs.items()}
    return DatabaseMatches(
        path, tuple(sorted(ids)), places, tuple(notes), sizes, cameras, ids=ids, table=table
    )
