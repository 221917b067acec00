"""A model with queries that were located in it."""

from collections.abc import Mapping, Sequence
from pathlib import Path

import numpy as np

from dgc_pose.errors import ArgumentName, InputError
from dgc_pose.geometry.pixels import exif_turn
from dgc_pose.images.image import image_header
from dgc_pose.localization.location import Location
from dgc_pose.model import Model, require_model_folder


def require_addable(out: Path, model: Model, paths: Sequence[str]) -> None:
    """Raise InputError if the folder `out` holds other files than a model's, a query has the name
    of another or of an image of the model, or its pixels as stored are a mirror image."""
    require_model_folder(out)
    names = model.names
    for path in paths:
        name, orientation = Path(path).name, image_header(Path(path)).exif.orientation
        if name in names:
            raise InputError(ArgumentName("add"), f"has an image {name} already, not {path} too")
        if np.linalg.det(exif_turn(orientation)) < 0:
            raise InputError(
                f"{path}: by EXIF orientation {orientation} its pixels are a mirror image"
            )
        names.add(name)


def write_model_with(out: Path, model: Model, locations: Mapping[str, Location]) -> None:
    """Write a model as COLMAP's binary files, with those queries that are located, by their paths:
    each with a camera of its own, of its pixels as stored, and without points. Raises InputError if
    COLMAP cannot hold a camera."""
    added = {}
    for path, location in locations.items():
        pose, camera = location.cam_from_world, location.camera
        if pose is not None and camera is not None:
            added[Path(path)] = camera, pose
    model.write(out, added)
