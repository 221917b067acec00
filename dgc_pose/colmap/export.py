"""From a finished batch to key points that its pairs share, and a COLMAP database.

A batch is of upright images; COLMAP reads the pixels as stored, and the database is of these.
"""

from collections.abc import Callable
from dataclasses import replace
from pathlib import Path

import numpy as np

from dgc_pose.batch.result import Batch
from dgc_pose.batch.rows import PairRow
from dgc_pose.colmap.database import write_database
from dgc_pose.colmap.shared import PairGeometry, SharedMatches
from dgc_pose.colmap.tracking import track_corners
from dgc_pose.errors import InputError
from dgc_pose.estimation.status import CONFIGURATIONS
from dgc_pose.geometry.pixels import Size, exif_turn, turn_points
from dgc_pose.images.image import image_header
from dgc_pose.images.store import ImageStore


def share(
    batch: Batch,
    per_image: int,
    progress: Callable[[int, int], None] = lambda done, of: None,
) -> SharedMatches:
    """The shared key points of a batch, of the pixels as stored. per_image: most corners of an
    image.

    Raises InputError if no pair has a pose; ImageError if an image cannot be read any more.
    """
    pairs = pair_geometries(batch)
    if not pairs:
        raise InputError(f"{batch.folder}: no pair of this batch has a pose")
    root, masks = batch.plan.root, batch.plan.settings.get("masks")
    shared = track_corners(pairs, ImageStore(root, masks).get, per_image, progress)
    key_points = {n: turn_points(p, *_to_stored(root / n)) for n, p in shared.key_points.items()}
    return SharedMatches(key_points, shared.pairs)


def _to_stored(path: Path) -> tuple[np.ndarray, Size]:
    """The turn (2, 2) of an upright image to the pixels as stored, and its (width, height)."""
    header = image_header(path)
    return exif_turn(header.exif.orientation).T, header.size


def pair_geometries(batch: Batch) -> list[PairGeometry]:
    """The pairs with a pose or a rotation, the matches that fit it, and the cameras: those of the
    folder, or as the pair fitted them."""
    geometries, final = [], batch.plan.final_cameras
    for pair in batch.pairs():
        row, pose = pair.row, pair.row.pose
        if pose is not None and pose.status in CONFIGURATIONS:
            inliers = pair.matches.subset(pose.inliers)
            arrays = inliers.points1, inliers.points2, inliers.confidence
            of_folder = final[row.name1], final[row.name2]
            cameras = row.fitted_cameras or of_folder
            geometries.append(PairGeometry(row, cameras, *arrays))
    return geometries


def write_shared(batch: Batch, shared: SharedMatches, database: Path) -> None:
    """Write the database of key points of `share`, over what is there. Raises as
    `write_database`."""
    plan = batch.plan
    turns = {name: _to_stored(plan.root / name) for name in plan.final_cameras}
    cameras = {name: camera.turned(*turns[name]) for name, camera in plan.final_cameras.items()}
    rows = [
        _as_stored(row, *(turns[name][0] for name in row.names))
        for row in batch.rows
        if row.names in shared.pairs
    ]
    write_database(database, plan.names, cameras, shared, rows)


def _as_stored(row: PairRow, turn1: np.ndarray, turn2: np.ndarray) -> PairRow:
    """A row whose pose is of the pixels as stored. turn1, turn2: (2, 2) from the upright images."""
    turn1, turn2 = (np.block([[t, np.zeros((2, 1))], [0, 0, 1]]) for t in (turn1, turn2))
    pose = row.pose
    assert pose is not None and pose.R is not None  # by its status
    t = None if pose.t is None else turn2 @ pose.t
    return replace(row, pose=replace(pose, R=turn2 @ pose.R @ turn1.T, t=t))
