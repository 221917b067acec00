"""COLMAP's databases and models as inputs: cameras, images and pairs, through pycolmap."""

from __future__ import annotations

import shutil
import sqlite3
import struct
from collections.abc import Mapping, Sequence
from contextlib import closing
from pathlib import Path
from typing import TYPE_CHECKING, Any

from dgc_pose.cameras import colmap_camera
from dgc_pose.cameras.camera import Camera
from dgc_pose.cameras.pair_list import PairList
from dgc_pose.errors import InputError, reason
from dgc_pose.files.inputs import TEXT_BYTES, read_as, read_bytes, require_regular
from dgc_pose.files.outputs import scratch_folder, writing
from dgc_pose.system.stderr import quiet

if TYPE_CHECKING:
    import pycolmap

# Of an images.bin: a number of images or points, and an image; bytes of a point.
_COUNT, _IMAGE, _POINT_BYTES = struct.Struct("<Q"), struct.Struct("<I7dI"), 24
_NOTHING = {".txt": b"", ".bin": struct.pack("<Q", 0)}  # a file of no images or no points
_FAILURES = (RuntimeError, ValueError, KeyError, TypeError, ArithmeticError, MemoryError)


def camera_of(camera: pycolmap.Camera) -> Camera:
    """COLMAP's camera as ours. Raises InputError for a model without a focal length."""
    K, distortion = colmap_camera.intrinsics(camera.model.name, camera.params.tolist())
    return Camera(K, (int(camera.width), int(camera.height)), distortion)


def find_file(folder: Path, name: str) -> Path | None:
    """The file of a folder that has a name in small letters, or the same in capitals."""
    alike = sorted(path for path in folder.iterdir() if path.name.lower() == name)
    return next((path for path in reversed(alike) if path.is_file()), None)


def read_model_cameras(path: Path) -> tuple[dict[int, Camera], dict[str, int]]:
    """The cameras of a cameras.txt or cameras.bin by their id, and the camera id of each image, if
    images.txt or images.bin lies beside it.

    Raises InputError, with the path, if a file cannot be read.
    """
    from dgc_pose.system.colmap_library import pycolmap

    ending = path.suffix.lower()
    content = read_bytes(path, TEXT_BYTES)
    with scratch_folder() as folder:
        for name in ("cameras", "images", "points3D"):  # pycolmap reads whole models alone
            file = folder / f"{name}{ending}"
            with writing(file):
                file.write_bytes(content if name == "cameras" else _NOTHING[ending])
        model = pycolmap.Reconstruction()
        try:
            with quiet():
                model.read_text(folder) if ending == ".txt" else model.read_binary(folder)
            cameras = {int(key): camera_of(camera) for key, camera in model.cameras.items()}
        except (ValueError, RuntimeError, IndexError, MemoryError, OverflowError) as error:
            raise InputError(f"{path}: not COLMAP's cameras ({reason(error)})") from None
    if not cameras:
        raise InputError(f"{path}: no cameras in this file")
    images = find_file(path.parent, f"images{ending}")
    if images is None:
        return cameras, {}
    data = read_bytes(images)
    with read_as("COLMAP's images", images):
        return cameras, _text_images(data) if ending == ".txt" else _binary_images(data)


# pycolmap's reader of an images.bin that is cut within a name never ends.


def _binary_images(data: bytes) -> dict[str, int]:
    """The camera id by image name, from an images.bin."""
    camera_ids: dict[str, int] = {}
    (count,) = _COUNT.unpack_from(data)
    start = _COUNT.size
    for _ in range(count):
        camera_id = _IMAGE.unpack_from(data, start)[-1]
        name_end = data.index(b"\0", start + _IMAGE.size)
        camera_ids[data[start + _IMAGE.size : name_end].decode()] = camera_id
        (points,) = _COUNT.unpack_from(data, name_end + 1)
        start = name_end + 1 + _COUNT.size + _POINT_BYTES * points
    if start > len(data):
        raise ValueError("points are missing")
    return camera_ids


def _text_images(data: bytes) -> dict[str, int]:
    """The same from an images.txt: two lines an image, the second of its points."""
    camera_ids: dict[str, int] = {}
    lines = iter(data.decode().splitlines())
    for line in lines:
        words = line.split(maxsplit=9)
        if words and not words[0].startswith("#"):
            if len(words) < 10:
                raise ValueError("an image without a name")
            camera_ids[words[9].strip()] = int(words[8])
            next(lines, None)
    return camera_ids


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
