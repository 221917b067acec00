"""COLMAP's cameras: a line of cameras.txt, the files, the folder of a model, and databases.

The principal point has (0.5, 0.5) at the centre of the top-left pixel, half a pixel more than ours.
pycolmap's own reader needs all files of a model, takes a cameras.bin that is cut within a camera,
and never ends in an images.bin that is cut within a name. It changes a database of an older COLMAP,
and ends the process where a column is of another type.
"""

import re
import sqlite3
import struct
from contextlib import closing
from dataclasses import replace
from pathlib import Path

import numpy as np

from dgc_pose.cameras import colmap_camera
from dgc_pose.cameras.by_image import Calibration
from dgc_pose.cameras.camera import Camera
from dgc_pose.cameras.formats.keyed import pose_matrix
from dgc_pose.cameras.pair_list import PairList
from dgc_pose.errors import InputError, shortened
from dgc_pose.geometry.pixels import Size
from dgc_pose.system.files import TEXT_BYTES, open_file, read_as, read_bytes

_LINE = re.compile(r"\s*(?:\d+[\s,]+)?[A-Za-z][A-Za-z_]*[\s,]+\d")  # [id] MODEL width
# Of a cameras.bin: a number of cameras, and a camera; of an images.bin: an image.
_COUNT, _CAMERA, _IMAGE = struct.Struct("<Q"), struct.Struct("<IiQQ"), struct.Struct("<I7dI")
_POINT_BYTES = 24
# Views, triggers, virtual tables and generated columns are programs, which may run for ever.
_PROGRAMS = """
    SELECT name FROM sqlite_master
    WHERE type NOT IN ('table', 'index') OR sql LIKE 'CREATE VIRTUAL%'
    UNION ALL
    SELECT tables.name FROM sqlite_master AS tables JOIN pragma_table_xinfo(tables.name)
    WHERE tables.type = 'table' AND hidden
"""
_IMAGES = """
    SELECT image_id, CAST(name AS TEXT), model, width, height, params FROM images
    LEFT JOIN cameras ON cameras.camera_id = images.camera_id AND prior_focal_length
"""
_MAX_IMAGES = 2**31 - 1  # COLMAP's number of a pair is id1 * _MAX_IMAGES + id2


def is_line(text: str) -> bool:
    """Whether a text begins as a line of cameras.txt does, with or without the id."""
    return _LINE.match(text) is not None


def parse_line(text: str) -> Camera:
    """The camera of `[id] MODEL width height parameters...`, split by blanks or commas.

    Raises InputError.
    """
    words = re.split(r"[\s,]+", text.strip())
    model, *numbers = words[1:] if words[0].isdecimal() else words
    try:
        width, height = map(int, numbers[:2])
        parameters = list(map(float, numbers[2:]))
    except ValueError:
        raise InputError(
            f"expected MODEL,width,height,parameters, not {shortened(text.strip())!r}"
        ) from None
    return _camera(model.upper(), (width, height), parameters)


def read_model(folder: Path) -> Calibration:
    """The cameras of the folder of a model. Raises InputError."""
    for name in ("cameras.bin", "cameras.txt"):
        if (folder / name).is_file():
            return read_cameras(folder / name)
    raise InputError(folder, "holds no cameras.txt and no cameras.bin")


def read_cameras(path: Path) -> Calibration:
    """The cameras of a cameras.txt or cameras.bin by their ids, and by the images in the images.txt
    or images.bin beside it; without one a single camera is that of all images.

    Raises InputError, with the path, if a file cannot be read.
    """
    is_text = path.suffix.lower() != ".bin"
    with read_as("COLMAP's cameras", path):
        data = read_bytes(path, TEXT_BYTES)
        cameras = _text_cameras(data) if is_text else _binary_cameras(data)
    if not cameras:
        raise InputError(path, "has no cameras")
    cameras = {key: replace(value, identity=f"{path} {key}") for key, value in cameras.items()}
    parts = {str(key): camera for key, camera in cameras.items()}
    images = path.with_name("images.txt" if is_text else "images.bin")
    if images.is_file():
        data = read_bytes(images)
        with read_as("COLMAP's images", images):
            posed = _text_images(data) if is_text else _binary_images(data)
        by_name = {name: cameras[key] for name, (key, _) in posed.items() if key in cameras}
        if by_name:
            poses = {name: posed[name][1] for name in by_name}
            return Calibration("", by_name, parts, poses=poses)
    return Calibration(parts=parts, common=cameras[min(cameras)] if len(cameras) == 1 else None)


def _camera(model: str, size: Size, parameters: list[float]) -> Camera:
    K, distortion = colmap_camera.intrinsics(model, parameters)
    return Camera(K, size, distortion)


def _text_cameras(data: bytes) -> dict[int, Camera]:
    lines = [line for line in data.decode("utf-8-sig").splitlines() if not line.startswith("#")]
    return {int(line.split()[0]): parse_line(line) for line in lines if line.strip()}


def _binary_cameras(data: bytes) -> dict[int, Camera]:
    cameras: dict[int, Camera] = {}
    (count,) = _COUNT.unpack_from(data)
    start = _COUNT.size
    for _ in range(count):
        key, model_id, width, height = _CAMERA.unpack_from(data, start)
        model, parameter_count = colmap_camera.model_of_id(model_id)
        numbers = struct.unpack_from(f"<{parameter_count}d", data, start + _CAMERA.size)
        cameras[key] = _camera(model, (width, height), list(numbers))
        start += _CAMERA.size + 8 * parameter_count
    return cameras


def _binary_images(data: bytes) -> dict[str, tuple[int, np.ndarray]]:
    """The camera id and cam_from_world (3, 4) by image name, from an images.bin."""
    images: dict[str, tuple[int, np.ndarray]] = {}
    (count,) = _COUNT.unpack_from(data)
    start = _COUNT.size
    for _ in range(count):
        _, *pose, camera_id = _IMAGE.unpack_from(data, start)
        name_end = data.index(b"\0", start + _IMAGE.size)
        name = data[start + _IMAGE.size : name_end].decode()
        images[name] = camera_id, pose_matrix(pose)
        (points,) = _COUNT.unpack_from(data, name_end + 1)
        start = name_end + 1 + _COUNT.size + _POINT_BYTES * points
    if start > len(data):
        raise ValueError("points are missing")
    return images


def _text_images(data: bytes) -> dict[str, tuple[int, np.ndarray]]:
    """The same from an images.txt: two lines an image, the second of its points."""
    images: dict[str, tuple[int, np.ndarray]] = {}
    lines = iter(data.decode("utf-8-sig").splitlines())
    for line in lines:
        words = line.split(maxsplit=9)
        if words and not words[0].startswith("#"):
            if len(words) < 10:
                raise ValueError("an image without a name")
            images[words[9].strip()] = int(words[8]), pose_matrix([*map(float, words[1:8])])
            next(lines, None)
    return images


def read_database(path: Path) -> PairList:
    """The images, cameras with a known focal length and matched pairs of a COLMAP database, of one
    that is being written those that SQLite's log beside it has too. The file stays as it is.

    Raises InputError, with the path, if it is none that can be read.
    """
    open_file(path).close()
    file = path.resolve()
    logs = [log for end in ("-wal", "-journal") if (log := Path(f"{file}{end}")).is_file()]
    names = [log.name for log in logs if log.stat().st_size]  # without these it is not whole
    uri = f"{file.as_uri()}?{'mode=ro' if names else 'immutable=1'}"
    with (
        read_as(" with ".join(["a COLMAP database", *names]), path),
        closing(sqlite3.connect(uri, uri=True)) as database,
    ):
        try:
            return _database_content(database)
        except InputError as error:
            raise ValueError(str(error)) from None


def _database_content(database: sqlite3.Connection) -> PairList:
    for (program,) in database.execute(_PROGRAMS):
        raise ValueError(f"{program} computes")
    names: dict[int, str] = {}
    cameras: dict[str, Camera] = {}
    for image_id, name, model_id, width, height, parameters in database.execute(_IMAGES):
        names[image_id] = name
        if model_id is not None:
            model, count = colmap_camera.model_of_id(model_id)
            values = struct.unpack_from(f"<{count}d", parameters)
            cameras[name] = _camera(model, (int(width), int(height)), list(values))
    keys = database.execute("SELECT pair_id FROM matches WHERE rows > 0")
    ids = [divmod(key, _MAX_IMAGES) for (key,) in keys]
    pairs = sorted((names[first], names[second]) for first, second in ids)
    return PairList(tuple(sorted(names.values())), tuple(pairs), cameras)
