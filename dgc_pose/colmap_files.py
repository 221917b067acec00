"""COLMAP's databases and models as inputs: cameras, images and pairs, through pycolmap."""

from __future__ import annotations

import shutil
import struct
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Any

from dgc_pose import colmap_camera
from dgc_pose.camera import Camera
from dgc_pose.errors import InputError, reason
from dgc_pose.files import scratch_folder
from dgc_pose.inputs import require_regular
from dgc_pose.stderr import quiet

if TYPE_CHECKING:
    import pycolmap

_NOTHING = {".txt": b"", ".bin": struct.pack("<Q", 0)}  # a file of no images or no points


@dataclass(frozen=True)
class DatabaseContent:
    """What a COLMAP database says of images."""

    cameras: dict[str, Camera]  # by image name; those without a prior focal length are absent
    names: tuple[str, ...]  # of all images, sorted
    pairs: tuple[tuple[str, str], ...]  # those matched; may be empty


def camera_of(camera: pycolmap.Camera) -> Camera:
    """COLMAP's camera as ours. Raises InputError for a model without a focal length."""
    K, distortion = colmap_camera.intrinsics(camera.model.name, camera.params.tolist())
    return Camera(K, (int(camera.width), int(camera.height)), distortion)


def read_model_cameras(path: Path) -> tuple[dict[int, Camera], dict[str, int]]:
    """The cameras of a cameras.txt or cameras.bin by their number, and the number of the camera of
    each image, if images.txt or images.bin lies beside it; else none.

    Raises InputError, with the path, if a file cannot be read.
    """
    import pycolmap

    with scratch_folder() as folder:
        ending = path.suffix
        for name in ("cameras", "images", "points3D"):
            # pycolmap reads whole models alone. The points are of no use, and may be large.
            source = path.with_name(name + ending)
            if name != "points3D" and source.is_file():
                shutil.copyfile(source, Path(folder, source.name))
            else:
                Path(folder, source.name).write_bytes(_NOTHING[ending])
        model = pycolmap.Reconstruction()
        try:
            with quiet():
                model.read_text(folder) if ending == ".txt" else model.read_binary(folder)
            cameras = {int(key): camera_of(own) for key, own in model.cameras.items()}
        except (ValueError, RuntimeError, IndexError, MemoryError, OverflowError) as error:
            raise InputError(f"{path}: not COLMAP's cameras ({reason(error)})") from None
    if not cameras:
        raise InputError(f"{path}: no cameras in this file")
    return cameras, {image.name: int(image.camera_id) for image in model.images.values()}


def read_database(path: Path) -> DatabaseContent:
    """The images, cameras and matched pairs of a COLMAP database, which stays as it is.

    Raises InputError, with the path, if it is none that this version of pycolmap reads.
    """
    import pycolmap

    if not path.is_file():
        raise InputError(f"{path}: no such database")
    require_regular(path)
    with scratch_folder() as folder:
        # Opening a database of an older COLMAP changes it, so a copy is opened.
        copy = Path(folder, "database.db")
        shutil.copyfile(path, copy)
        try:
            with quiet(), pycolmap.Database.open(copy) as database:
                cameras = {own.camera_id: own for own in database.read_all_cameras()}
                images = database.read_all_images()
                keys, _ = database.read_all_matches()
        except (RuntimeError, ValueError, KeyError, TypeError, MemoryError) as error:
            raise InputError(f"{path}: not a COLMAP database ({reason(error)})") from None
    try:
        return _content(cameras, images, keys)
    except (KeyError, ValueError, TypeError, OverflowError) as error:
        raise InputError(f"{path}: not a COLMAP database ({reason(error)})") from None


def _content(
    cameras: Mapping[int, Any], images: Sequence[Any], keys: Sequence[int]
) -> DatabaseContent:
    import pycolmap

    names = {image.image_id: image.name for image in images}
    pairs = [pycolmap.pair_id_to_image_pair(key) for key in keys]
    return DatabaseContent(
        {
            image.name: camera_of(cameras[image.camera_id])
            for image in images
            if cameras[image.camera_id].has_prior_focal_length
        },
        tuple(sorted(names.values())),
        tuple(sorted((names[first], names[second]) for first, second in pairs)),
    )
