"""COLMAP's databases as inputs: cameras, images and pairs.

Read as SQLite: pycolmap changes a database of an older COLMAP, and ends the process where a column
is of another type.
"""

import sqlite3
from contextlib import closing
from pathlib import Path
from struct import unpack_from

from dgc_pose.cameras import colmap_camera
from dgc_pose.cameras.camera import Camera
from dgc_pose.cameras.pair_list import PairList
from dgc_pose.files.inputs import read_as, require_regular

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


def read_database(path: Path) -> PairList:
    """The images, cameras with a known focal length and matched pairs of a COLMAP database.

    Raises InputError, with the path, if it is none that can be read.
    """
    require_regular(path)
    uri = f"{path.absolute().as_uri()}?immutable=1"
    with (
        read_as("a COLMAP database", path),
        closing(sqlite3.connect(uri, uri=True)) as database,
    ):
        for (program,) in database.execute(_PROGRAMS):
            raise ValueError(f"{program} computes")
        names: dict[int, str] = {}
        cameras: dict[str, Camera] = {}
        for image_id, name, model_id, width, height, parameters in database.execute(_IMAGES):
            names[image_id] = name
            if model_id is not None:
                model, count = colmap_camera.model_of_id(model_id)
                values = unpack_from(f"<{count}d", parameters)
                K, distortion = colmap_camera.intrinsics(model, list(values))
                cameras[name] = Camera(K, (int(width), int(height)), distortion)
        keys = database.execute("SELECT pair_id FROM matches WHERE rows > 0")
        ids = [divmod(key, _MAX_IMAGES) for (key,) in keys]
        pairs = sorted((names[first], names[second]) for first, second in ids)
        return PairList(tuple(sorted(names.values())), tuple(pairs), cameras)
