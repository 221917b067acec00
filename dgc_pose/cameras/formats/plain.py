"""Numbers: fx fy cx cy or a 3x3 matrix as text or .npy, and a table of cameras.

Pixels have (0, 0) at the centre of the top-left pixel.
"""

import csv
import re
from dataclasses import replace
from pathlib import Path

from dgc_pose.cameras.formats.file_cameras import FileCameras, numbers_camera
from dgc_pose.cameras.formats.keyed import keyed_camera
from dgc_pose.errors import InputError, reason
from dgc_pose.files.arrays import read_array
from dgc_pose.files.inputs import read_as


def numbers_of(text: str) -> list[float] | None:
    """The numbers of a text, split by commas and blanks; None if it has anything else."""
    try:
        return [float(word) for word in re.split(r"[\s,]+", text.strip().strip(","))]
    except ValueError:
        return None


def read_npy(path: Path) -> FileCameras:
    """The camera of an .npy. Raises InputError."""
    return FileCameras(common=numbers_camera(read_array(path)))


def read_table(text: str, path: Path) -> FileCameras:
    """The cameras of a .csv with the columns name, fx, fy, cx, cy, and optionally width, height,
    focal_std, centre_std_px, camera, equal for images of one camera, and those of a lens.

    Raises InputError, with the path and line, also for a name with two cameras.
    """
    with read_as("a table of cameras", path):
        rows = list(csv.DictReader(text.splitlines()))
    by_name: dict[str, dict[str, str]] = {}
    cameras = {}
    for number, row in enumerate(rows, start=2):
        try:
            if any(row.pop(None, ())):
                raise ValueError("more cells than columns")
            if by_name.setdefault(row["name"], row) != row:
                raise InputError(f"another camera of {row['name']} than in a line before")
            camera = keyed_camera(row)
            cameras[row["name"]] = replace(camera, identity=row.get("camera") or None)
        except InputError as error:
            raise InputError(f"{path}:{number}: {error}") from None
        except (KeyError, TypeError, ValueError, OverflowError) as error:
            raise InputError(
                f"{path}:{number}: expected the columns name,fx,fy,cx,cy[,width,height] "
                f"({reason(error)})"
            ) from None
    if not cameras:
        raise InputError(f"{path}: no cameras in this table")
    return FileCameras(cameras)
