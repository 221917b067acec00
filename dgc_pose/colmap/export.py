"""From a finished batch to key points that its pairs share."""

from collections.abc import Callable

import numpy as np

from dgc_pose.batch.result import Batch
from dgc_pose.colmap.shared import PairGeometry, SharedMatches
from dgc_pose.colmap.tracking import track_corners
from dgc_pose.errors import InputError
from dgc_pose.estimation.status import CONFIGURATIONS
from dgc_pose.images.store import ImageStore


def share(
    batch: Batch,
    per_image: int,
    progress: Callable[[int, int], None] = lambda done, of: None,
) -> SharedMatches:
    """The shared key points of a batch. per_image: most corners of an image.

    Raises InputError if no pair has a pose; ImageError if an image cannot be read any more.
    """
    pairs = pair_geometries(batch)
    if not pairs:
        raise InputError(f"{batch.folder}: no pair of this batch has a pose")
    images = ImageStore(batch.plan.root, batch.plan.settings.get("masks"))
    return track_corners(pairs, images.get, per_image, progress)


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
