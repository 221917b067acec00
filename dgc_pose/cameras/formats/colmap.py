"""COLMAP's cameras: a line of cameras.txt, models, and databases.

In COLMAP, the centre of the top-left pixel is (0.5, 0.5), so its principal point is half a pixel
more than that of `Camera`. pycolmap reads the models. It accepts a cameras.bin cut off within a
camera, and never returns from an images.bin cut off within a name, so this module checks both files
first. It reads databases with sqlite3, because pycolmap modifies a database of an older COLMAP, and
ends the process if a column has another type.
"""

from __future__ import annotations

import re
import sqlite3
import struct
from collections.abc import Callable, Iterator, Mapping
from contextlib import closing, contextmanager
from pathlib import Path
from typing import TYPE_CHECKING, Literal
from urllib.parse import quote, unquote

import numpy as np

from dgc_pose.cameras import colmap_camera
from dgc_pose.cameras.by_image import Calibration
from dgc_pose.cameras.camera import Camera
from dgc_pose.cameras.formats.opened import CameraFile
from dgc_pose.cameras.pair_list import PairList
from dgc_pose.errors import InputError, shortened
from dgc_pose.geometry.pixels import Size
from dgc_pose.system.files import open_file, read_as, read_bytes, scratch_folder

if TYPE_CHECKING:
    import pycolmap

_LINE = re.compile(r"\s*(?:\d+[\s,]+)?[A-Za-z][A-Za-z_]*[\s,]+\d")  # [id] MODEL width
# The number of items in a cameras.bin or images.bin; a camera; an image.
_COUNT = struct.Struct("<Q")
_CAMERA = struct.Struct("<IiQQ")
_IMAGE = struct.Struct("<I7dI")
_POINT_BYTES = 24
_ROUNDING = 0.01  # largest error of the length of a unit quaternion in a file
# Views, triggers, virtual tables and generated columns are programs that may never end.
_PROGRAMS = """
    SELECT name FROM sqlite_master
    WHERE type NOT IN ('table', 'index') OR sql LIKE 'CREATE VIRTUAL%'
    UNION ALL
    SELECT tables.name FROM sqlite_master AS tables JOIN pragma_table_xinfo(tables.name)
    WHERE tables.type = 'table' AND hidden
"""
_IMAGES = """
    SELECT image_id, CAST(name AS TEXT), model, width, height, params, prior_focal_length
    FROM images LEFT JOIN cameras ON cameras.camera_id = images.camera_id
"""
_FILES = ("cameras", "images", "points3D", "rigs", "frames")  # of a model, without endings
Table = Literal["matches", "two_view_geometries"]  # of a database, with matches by pair
_MAX_IMAGES = 2**31 - 1  # COLMAP's pair_id is id1 * _MAX_IMAGES + id2


def read(file: CameraFile) -> Calibration | None:
    """The cameras of a model's folder, cameras.txt or cameras.bin, or the camera of a single line
    without an id; None for another file."""
    if file.path.is_dir() or file.ending == ".bin":
        return read_model(file.path)[0]
    if file.has_data or not is_line(file.lines[0]):
        return None
    if file.lines[0].split()[0].isdecimal():
        return read_model(file.path)[0]
    return Calibration(common=parse_line(file.lines[0])) if len(file.lines) == 1 else None


def is_line(text: str) -> bool:
    """Whether a text begins like a line of cameras.txt, with or without the id."""
    return _LINE.match(text) is not None


def parse_line(text: str) -> Camera:
    """Parse `[id] MODEL width height parameters...`, split by blanks or commas.

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


def read_model(path: Path, whole: bool = False) -> tuple[Calibration, pycolmap.Reconstruction]:
    """Read a COLMAP model: a folder, or a cameras.txt or .bin with the other files beside it.
    The calibration has the cameras by id, and the cameras and poses of images with a pose by image
    name. A single camera without images is the common one.

    whole: also read points, rigs and frames. Raises InputError, with the path, if a file cannot be
    read, or if a camera has no focal length.
    """
    from dgc_pose.system.colmap_library import pycolmap

    if path.is_dir():
        files = [file for end in ("bin", "txt") if (file := path / f"cameras.{end}").is_file()]
        if not files:
            raise InputError(path, "holds no cameras.txt and no cameras.bin")
        path = files[0]

    is_text = path.suffix.lower() != ".bin"
    wanted = {stem: path.with_name(stem + (".txt" if is_text else ".bin")) for stem in _FILES}
    wanted |= {"cameras": path}

    with read_as("a COLMAP model", path.parent), scratch_folder() as scratch:
        for stem, file in wanted.items():
            copy = scratch / f"{stem}{'.txt' if is_text else '.bin'}"
            if not file.is_file() or not (whole or stem in ("cameras", "images")):
                if stem in ("images", "points3D"):  # required by pycolmap
                    copy.write_bytes(b"" if is_text else bytes(_COUNT.size))
            elif is_text:
                with read_as(f"COLMAP's {stem}", file):
                    text = read_bytes(file).decode("utf-8-sig")
                if stem == "cameras":
                    text = _checked_lines(text, file)
                if stem == "images":
                    text = _with_quoted_names(text, with_points=whole)
                copy.write_text(text, encoding="utf-8")
            else:
                copy.symlink_to(file.absolute())

        checks = {} if is_text else {"cameras": _camera_bytes, "images": _image_bytes}
        for stem, item_bytes in checks.items():
            with read_as(f"COLMAP's {stem}", wanted[stem]):
                _require_whole(read_bytes(scratch / f"{stem}.bin"), item_bytes)

        model = pycolmap.Reconstruction(scratch)
        for image in model.images.values() if is_text else ():
            image.name = unquote(image.name)
        if not model.cameras:
            raise InputError(path, "has no cameras")
        for _, image in sorted(model.images.items()):
            if image.has_pose and not _is_rigid(image.cam_from_world()):
                raise InputError(path.parent, f"has a pose of {image.name} that is not rigid")
        return model_calibration(model, path), model


def _is_rigid(pose: pycolmap.Rigid3d) -> bool:
    is_unit = abs(np.linalg.norm(pose.rotation.quat) - 1) < _ROUNDING
    return bool(is_unit and np.isfinite(pose.translation).all())


def model_calibration(model: pycolmap.Reconstruction, path: Path) -> Calibration:
    """The calibration of `read_model` from COLMAP's model. path: for the identity of the cameras.
    Raises InputError if a camera has no focal length."""
    cameras: dict[int, Camera] = {}
    for key, theirs in sorted(model.cameras.items()):
        K, lens = colmap_camera.intrinsics(theirs.model.name, theirs.params.tolist())
        size = theirs.width, theirs.height
        cameras[key] = Camera(K, size, lens, identity=f"{path} {key}")
    images = [image for _, image in sorted(model.images.items()) if image.has_pose]
    return Calibration(
        by_name={image.name: cameras[image.camera_id] for image in images},
        parts={str(key): camera for key, camera in cameras.items()},
        common=None if images or len(cameras) > 1 else next(iter(cameras.values())),
        poses={image.name: np.array(image.cam_from_world().matrix()) for image in images},
    )


def _checked_lines(text: str, path: Path) -> str:
    """A cameras.txt with the model names in capitals. Raises InputError, with the path, for a line
    that is not a camera."""
    for line in text.splitlines():
        if line.strip() and not line.startswith("#"):
            try:
                parse_line(line)
            except InputError as error:
                raise InputError(path, f"has a line that is not a camera: {error}") from None
    return text.upper()


def _with_quoted_names(text: str, *, with_points: bool) -> str:
    """An images.txt with its names percent-encoded, since pycolmap cuts names at blanks."""
    rows = []
    lines = iter(text.splitlines())
    for line in lines:
        words = line.split(maxsplit=9)
        if len(words) == 10 and not line.startswith("#"):
            points = next(lines, "")
            name = quote(words[9].strip())
            rows += [" ".join([*words[:9], name]), points if with_points else ""]
        else:
            rows.append(line)
    return "\n".join([*rows, ""])


def _require_whole(data: bytes, item_bytes: Callable[[bytes, int], int]) -> None:
    """Raise ValueError or struct.error if a file has fewer items than its header states."""
    (count,) = _COUNT.unpack_from(data)
    start = _COUNT.size
    for _ in range(count):
        start += item_bytes(data, start)
        if start > len(data):
            raise ValueError("the file is cut off")


def _camera_bytes(data: bytes, start: int) -> int:
    _, model_id, _, _ = _CAMERA.unpack_from(data, start)
    return _CAMERA.size + 8 * colmap_camera.model_of_id(model_id)[1]


def _image_bytes(data: bytes, start: int) -> int:
    name_end = data.index(b"\0", start + _IMAGE.size)
    (points,) = _COUNT.unpack_from(data, name_end + 1)
    return name_end + 1 + _COUNT.size + _POINT_BYTES * int(points) - start


def _camera(model: str, size: Size, parameters: list[float]) -> Camera:
    K, distortion = colmap_camera.intrinsics(model, parameters)
    return Camera(K, size, distortion)


def database_files(path: Path) -> list[Path]:
    """The file of a database, and the logs of SQLite that complete it."""
    file = path.resolve()
    logs = [log for end in ("-wal", "-journal") if (log := Path(f"{file}{end}")).is_file()]
    return [path, *(log for log in logs if log.stat().st_size)]


@contextmanager
def open_database(path: Path) -> Iterator[sqlite3.Connection]:
    """A COLMAP database to read, including what is in SQLite's log beside it. The file is not
    modified. Raises InputError, with the path, for whatever the block cannot read."""
    open_file(path).close()
    _, *logs = database_files(path)
    names = [log.name for log in logs]
    uri = f"{path.resolve().as_uri()}?{'mode=ro' if logs else 'immutable=1'}"
    with (
        read_as(" with ".join(["a COLMAP database", *names]), path),
        closing(sqlite3.connect(uri, uri=True)) as database,
    ):
        for (program,) in database.execute(_PROGRAMS):
            raise ValueError(f"the database computes {program}, and only stored tables are read")
        try:
            yield database
        except InputError as error:
            raise ValueError(str(error)) from None


def read_database(path: Path) -> PairList:
    """Read the images, the cameras with a known focal length and the matched pairs of a COLMAP
    database. Raises InputError, with the path, if the database cannot be read."""
    with open_database(path) as database:
        ids, _, cameras = read_images(database)
        pairs = sorted(read_pairs(database, ids, "matches"))
        return PairList(tuple(sorted(ids)), tuple(pairs), cameras)


def read_images(
    database: sqlite3.Connection,
) -> tuple[dict[str, int], dict[str, Size], dict[str, Camera]]:
    """By the name of an image: its id, its size, and its camera if its focal length is known."""
    ids: dict[str, int] = {}
    sizes: dict[str, Size] = {}
    cameras: dict[str, Camera] = {}
    for image_id, name, model_id, width, height, parameters, is_known in database.execute(_IMAGES):
        ids[name] = image_id
        if model_id is not None:
            sizes[name] = int(width), int(height)
        if model_id is not None and is_known:
            model, count = colmap_camera.model_of_id(model_id)
            values = struct.unpack_from(f"<{count}d", parameters)
            cameras[name] = _camera(model, sizes[name], list(values))
    return ids, sizes, cameras


def read_pairs(
    database: sqlite3.Connection, ids: Mapping[str, int], table: Table
) -> dict[tuple[str, str], int]:
    """The pairs with matches in a table, by the names of their images, and their `pair_id`."""
    names = {image_id: name for name, image_id in ids.items()}
    pairs = {}
    for (key,) in database.execute(f"SELECT pair_id FROM {table} WHERE rows > 0"):
        first, second = divmod(key, _MAX_IMAGES)
        if lacking := {first, second} - names.keys():
            raise ValueError(f"{table} has a pair of image {min(lacking)}, which images lacks")
        pairs[names[first], names[second]] = key
    return pairs
