"""COLMAP's databases as inputs: cameras, images and pairs, through pycolmap."""

from __future__ import annotations

import shutil
import sqlite3
from collections.abc import Mapping, Sequence
from contextlib import closing
from pathlib import Path
from typing import TYPE_CHECKING, Any

from dgc_pose.cameras import colmap_camera
from dgc_pose.cameras.camera import Camera
from dgc_pose.cameras.pair_list import PairList
from dgc_pose.errors import InputError, reason
from dgc_pose.files.inputs import require_regular
from dgc_pose.files.outputs import scratch_folder
from dgc_pose.system.stderr import quiet

if TYPE_CHECKING:
    import pycolmap

_FAILURES = (RuntimeError, ValueError, KeyError, TypeError, ArithmeticError, MemoryError)


def camera_of(camera: pycolmap.Camera) -> Camera:
    """COLMAP's camera as ours. Raises InputError for a model without a focal length."""
    K, distortion = colmap_camera.intrinsics(camera.model.name, camera.params.tolist())
    return Camera(K, (int(camera.width), int(camera.height)), distortion)


def read_database(path: Path) -> PairList:
    """The images, cameras and matched pairs of a COLMAP database, which stays as it is.

    Raises InputError, with the path, if it is none that this version of pycolmap reads.
    """
    from dgc_pose.system.colmap_library import pycolmap

    require_regular(path)
    with scratch_folder() as folder:
        # Opening a database of an older COLMAP changes it, so a copy is opened.
        copy = folder / "database.db"
        shutil.copyfile(path, copy)
        try:
            _require_plain(copy)
            with quiet(), pycolmap.Database.open(copy) as database:
                cameras = {camera.camera_id: camera for camera in database.read_all_cameras()}
                images = database.read_all_images()
            # pycolmap's reader of matches ends the process where a column is of another type.
            with closing(sqlite3.connect(copy)) as plain:
                rows = plain.execute("SELECT pair_id FROM matches WHERE rows > 0")
                keys = [key for (key,) in rows]
            return _content(cameras, images, keys)
        except (*_FAILURES, sqlite3.Error) as error:
            why = reason(error)
            raise InputError(f"{path} is not a COLMAP database that can be read ({why})") from None


def _require_plain(path: Path) -> None:
    """Raise ValueError unless a database holds tables of stored columns alone: views, virtual
    tables and generated columns are programs, which may run for ever."""
    with closing(sqlite3.connect(path)) as database:
        for kind, name, sql in database.execute("SELECT type, name, sql FROM sqlite_master"):
            if kind not in ("table", "index") or str(sql).upper().startswith("CREATE VIRTUAL"):
                raise ValueError(f"a {kind} {name} that computes")
            if kind == "table":
                columns = database.execute("SELECT hidden FROM pragma_table_xinfo(?)", (name,))
                if any(hidden for (hidden,) in columns):
                    raise ValueError(f"a column of {name} that is computed")


def _content(cameras: Mapping[int, Any], images: Sequence[Any], keys: Sequence[int]) -> PairList:
    from dgc_pose.system.colmap_library import pycolmap

    names = {image.image_id: image.name for image in images}
    for image in images:
        if image.camera_id not in cameras:
            raise ValueError(f"{image.name} has the camera {image.camera_id}, which is not there")
    pairs = [pycolmap.pair_id_to_image_pair(key) for key in keys]
    if missing := {number for pair in pairs for number in pair} - names.keys():
        raise ValueError(f"matches of the image {min(missing)}, which is not there")
    cameras_by_name = {
        image.name: camera_of(cameras[image.camera_id])
        for image in images
        if cameras[image.camera_id].has_prior_focal_length
    }
    listed = sorted((names[first], names[second]) for first, second in pairs)
    return PairList(tuple(sorted(names.values())), tuple(listed), cameras_by_name)
