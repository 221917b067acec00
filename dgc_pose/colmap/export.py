"""From a finished batch to a COLMAP database."""

from collections import Counter
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from pathlib import Path

from dgc_pose.batch.result import Batch
from dgc_pose.colmap.database import write_database
from dgc_pose.colmap.shared import PairGeometry, SharedMatches
from dgc_pose.colmap.tracking import track_corners
from dgc_pose.errors import InputError
from dgc_pose.estimation.status import CONFIGURATIONS
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
    """Write the database of shared key points, over what is there."""
    plan = batch.plan
    rows = {pair.names: pair.row for pair in pairs}
    write_database(database, plan.names, plan.final_cameras, shared, rows)
    return Exported(
        images=sum(len(points) > 0 for points in shared.key_points.values()),
        key_points=sum(map(len, shared.key_points.values())),
        pairs=len(shared.pairs),
        matches=sum(map(len, shared.pairs.values())),
        tracks_by_length=dict(sorted(Counter(shared.track_lengths().tolist()).items())),
    )
