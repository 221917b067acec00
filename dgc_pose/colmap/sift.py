"""COLMAP's pipeline up to the matches: SIFT, exhaustive matching, verification, by pycolmap."""

from __future__ import annotations

from collections.abc import Mapping
from pathlib import Path

from dgc_pose.cameras.camera import Camera
from dgc_pose.colmap.database import colmap_camera
from dgc_pose.system.colmap_library import pycolmap


def sift_database(
    database: Path, images: Path, cameras: Mapping[str, Camera], threads: int = -1
) -> None:
    """Write a new database of SIFT key points and all verified pairs, with pycolmap's defaults.

    cameras: by image name, with their sizes; the focal lengths count as known. Raises InputError if
    COLMAP cannot hold a camera.
    """
    extraction = pycolmap.FeatureExtractionOptions()
    extraction.num_threads = threads
    extraction.use_gpu = False
    matching = pycolmap.FeatureMatchingOptions()
    matching.num_threads = threads
    matching.use_gpu = False
    pycolmap.extract_features(
        database,
        images,
        list(cameras),
        camera_mode=pycolmap.CameraMode.PER_IMAGE,
        extraction_options=extraction,
    )
    with pycolmap.Database.open(database) as opened:
        for image in opened.read_all_images():
            camera = colmap_camera(cameras[image.name], image.name)
            camera.camera_id = image.camera_id
            camera.has_prior_focal_length = True
            opened.update_camera(camera)
    pycolmap.match_exhaustive(database, matching_options=matching)
