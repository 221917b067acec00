"""From a finished batch to key points that its pairs share, and a COLMAP database.

A batch is of upright images; COLMAP reads the pixels as stored, and the database is of these.
"""

from collections.abc import Callable
from dataclasses import replace
from pathlib import Path

import numpy as np

from dgc_pose.batch.plan import Plan
from dgc_pose.batch.result import Batch
from dgc_pose.colmap.database import write_database
from dgc_pose.colmap.shared import PairGeometry, SharedMatches
from dgc_pose.colmap.tracking import track_corners
from dgc_pose.errors import InputError
from dgc_pose.estimation.status import CONFIGURATIONS
from dgc_pose.geometry.pixels import exif_turn, turn_points
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
    images = ImageStore(batch.plan.root, batch.plan.settings.get("masks"))
    return as_stored(batch.plan, track_corners(pairs, images.get, per_image, progress))


def pair_geometries(batch: Batch) -> list[PairGeometry]:
    """The pairs with a pose or a rotation, the matches that fit it, and the cameras: those of the
    folder, or as the pair fitted them."""
    geometries, final = [], batch.plan.final_cameras
    for row, matches in batch.matches():
        if row.status in CONFIGURATIONS:
            arrays = (matches.points1, matches.points2, matches.scores)
            inliers = (array[matches.inliers].astype(np.float64) for array in arrays)
            of_folder = final[row.name1], final[row.name2]
            cameras = matches.fitted.cameras if matches.fitted else of_folder
            geometries.append(PairGeometry(row, cameras, *inliers))
    return geometries


def as_stored(plan: Plan, shared: SharedMatches) -> SharedMatches:
    """Key points of upright images in the pixels as stored."""
    turned = {}
    for name, points in shared.key_points.items():
        size = plan.final_cameras[name].size
        assert size is not None
        turned[name] = turn_points(points, _turn_to_stored(plan, name), size)
    return replace(shared, key_points=turned)


def write_shared(batch: Batch, shared: SharedMatches, database: Path) -> None:
    """Write the database of key points of `share`, over what is there. Raises as
    `write_database`."""
    plan, cameras, rows, turns = batch.plan, {}, [], {}
    for name, camera in plan.final_cameras.items():
        assert camera.size is not None
        turn = _turn_to_stored(plan, name)
        cameras[name] = camera.turned(turn, camera.size)
        turns[name] = np.eye(3)
        turns[name][:2, :2] = turn
    for row in batch.rows:
        if row.names in shared.pairs and row.R is not None:
            turn1, turn2 = (turns[name] for name in row.names)
            R = turn2 @ np.reshape(row.R, (3, 3)) @ turn1.T
            t = None if row.t is None else tuple((turn2 @ row.t).tolist())
            rows.append(replace(row, R=tuple(R.ravel().tolist()), t=t))
    write_database(database, plan.names, cameras, shared, rows)


def _turn_to_stored(plan: Plan, name: str) -> np.ndarray:
    """The axes (2, 2) of the pixels as stored by those of the upright image."""
    return exif_turn(image_header(plan.root / name).exif.orientation).T
