"""A COLMAP model with photographs that were located in it."""

from collections.abc import Mapping, Sequence
from dataclasses import replace
from pathlib import Path

import numpy as np

from dgc_pose.cameras.camera import Camera
from dgc_pose.colmap.database import colmap_camera
from dgc_pose.colmap.reconstruction import require_model_folder
from dgc_pose.errors import ArgumentName, InputError
from dgc_pose.files.inputs import read_as
from dgc_pose.files.outputs import replaced_folder
from dgc_pose.images.image import image_header, image_size
from dgc_pose.localization.location import Location
from dgc_pose.localization.model import PosedModel
from dgc_pose.system.colmap_library import pycolmap

_QUARTERS = {1: 0, 3: 2, 6: 1, 8: 3}  # by EXIF orientation, turns that make an image upright


def write_model_with(out: Path, model: PosedModel, locations: Mapping[str, Location]) -> None:
    """Write the model with those photographs that are located, by their paths, as COLMAP's binary
    files: each with a camera of its own, of its pixels as stored, and without points.

    A model of COLMAP keeps all that it has; of another the cameras and poses are written. Raises
    InputError if COLMAP cannot hold a camera, and as `extensible` does.
    """
    reconstruction = extensible(out, model, list(locations))
    for path, location in locations.items():
        pose, camera = location.cam_from_world, location.camera
        if pose is not None and camera is not None:
            _add(reconstruction, Path(path).name, *_as_stored(camera, pose, image_size(path)))
    with replaced_folder(out) as folder:
        reconstruction.write_binary(folder)


def extensible(out: Path, model: PosedModel, paths: Sequence[str]) -> pycolmap.Reconstruction:
    """The model. Raises InputError if the folder holds other files, a photograph has the name of
    another or of an image of the model, or its pixels as stored are a mirror image."""
    require_model_folder(out)
    if model.files is None:
        reconstruction = pycolmap.Reconstruction()
        for name, pose in model.poses.items():
            _add(reconstruction, name, model.cameras[name], pose)
    else:
        with read_as("a COLMAP model", model.files):
            reconstruction = pycolmap.Reconstruction(model.files)
    names = {image.name for image in reconstruction.images.values()}
    for path in paths:
        name, turn = Path(path).name, image_header(Path(path)).orientation
        if name in names:
            raise InputError(ArgumentName("add"), f"has an image {name} already, not {path} too")
        if turn not in _QUARTERS:
            raise InputError(f"{path}: by EXIF orientation {turn} its pixels are a mirror image")
        names.add(name)
    return reconstruction


def _as_stored(
    camera: Camera, pose: np.ndarray, size: tuple[int, int]
) -> tuple[Camera, np.ndarray]:
    """A camera and cam_from_world of the upright image, for the pixels as stored, of this size."""
    turn, middle, lens = np.eye(3), (np.array(size) - 1) / 2, camera.distortion
    turn[:2, :2] = np.linalg.matrix_power([[0, -1], [1, 0]], _QUARTERS[camera.orientation])
    back = turn.T.copy()  # of pixels
    back[:2, 2] = middle - back[:2, :2] @ (np.abs(turn[:2, :2]) @ middle)
    if lens is not None and lens.model in ("OPENCV", "FULL_OPENCV"):
        k1, k2, p1, p2, *rest = lens.coefficients
        p2, p1 = (turn.T[:2, :2] @ (p2, p1)).tolist()
        lens = replace(lens, coefficients=(k1, k2, p1, p2, *rest))
    K = back @ camera.K @ turn
    return replace(camera, K=K, size=size, distortion=lens, orientation=1), turn.T @ pose


def _add(
    reconstruction: pycolmap.Reconstruction, name: str, camera: Camera, pose: np.ndarray
) -> None:
    """Add an image with a camera of its own."""
    added = colmap_camera(camera, name)
    added.camera_id = max(reconstruction.cameras, default=0) + 1
    reconstruction.add_camera_with_trivial_rig(added)
    image = pycolmap.Image(name=name, camera_id=added.camera_id)
    image.image_id = max(reconstruction.images, default=0) + 1
    cam_from_world = pycolmap.Rigid3d(pycolmap.Rotation3d(pose[:, :3]), pose[:, 3])
    reconstruction.add_image_with_trivial_frame(image, cam_from_world)
