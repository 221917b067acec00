"""From a finished batch to a COLMAP database."""

from collections import Counter
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np

from dgc_pose.batch.result import Batch
from dgc_pose.batch.rows import PairRow
from dgc_pose.colmap.database import write_database
from dgc_pose.colmap.shared import PairGeometry, SharedMatches
from dgc_pose.colmap.tracking import track_corners
from dgc_pose.errors import InputError
from dgc_pose.estimation.status import CONFIGURATIONS
from dgc_pose.geometry.pixels import exif_turn, turn_points
from dgc_pose.images.image import image_header
from dgc_pose.images.store import ImageStore


@dataclass(frozen=True)
class Exported:
    """The counts of what was written."""

    images: int  # with key points
    key_points: int
    pairs: int
    matches: int
    tracks_by_length: dict[int, int]  # tracks by number of views


def share(
    batch: Batch,
    per_image: int,
    progress: Callable[[int, int], None] = lambda done, of: None,
) -> tuple[SharedMatches, list[PairGeometry]]:
    """The shared key points of a batch, and the pairs that they are of. per_image: most corners of
    an image.

    Raises InputError if no pair has a pose; ImageError if an image cannot be read any more.
    """
    pairs = pair_geometries(batch)
    if not pairs:
        raise InputError(f"{batch.folder}: no pair of this batch has a pose")
    images = ImageStore(batch.plan.root, batch.plan.settings.get("masks"))
    return track_corners(pairs, images.get, per_image, progress), pairs


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


def write_shared(
    batch: Batch, shared: SharedMatches, pairs: Sequence[PairGeometry], database: Path
) -> Exported:
    """Write the database of shared key points, over what is there: of the pixels as stored, which
    COLMAP reads."""
    plan, cameras, key_points = batch.plan, dict(batch.plan.final_cameras), dict(shared.key_points)
    turns = {}
    for name, camera in plan.final_cameras.items():
        header = image_header(plan.root / name)
        turn = turns[name] = exif_turn(header.exif.orientation).T
        cameras[name] = camera.turned(turn, header.size)
        if name in key_points:
            key_points[name] = turn_points(key_points[name], turn, header.size)
    rows = {pair.names: _as_stored(pair.row, turns) for pair in pairs}
    stored = SharedMatches(key_points, shared.pairs)
    write_database(database, plan.names, cameras, stored, rows)
    return Exported(
        images=sum(len(points) > 0 for points in shared.key_points.values()),
        key_points=sum(map(len, shared.key_points.values())),
        pairs=len(shared.pairs),
        matches=sum(map(len, shared.pairs.values())),
        tracks_by_length=dict(sorted(Counter(shared.track_lengths().tolist()).items())),
    )


def _as_stored(row: PairRow, turns: Mapping[str, np.ndarray]) -> PairRow:
    """A row whose pose is of the pixels as stored. turns: (2, 2) from the upright images."""
    turn1, turn2 = (np.pad(turns[name], (0, 1)) for name in row.names)
    turn1[2, 2] = turn2[2, 2] = 1
    pose = row.pose
    assert pose is not None and pose.R is not None  # by its status
    t = None if pose.t is None else turn2 @ pose.t
    return replace(row, pose=replace(pose, R=turn2 @ pose.R @ turn1.T, t=t))
