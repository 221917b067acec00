"""Files that name the cameras of a rig: OpenCV's of a stereo pair, EasyMocap's intri.yml, and the
TOML of anipose, caliscope and Pose2Sim.
"""

import re
from collections.abc import Mapping
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np

from dgc_pose.cameras.by_image import Calibration
from dgc_pose.cameras.camera import Camera
from dgc_pose.cameras.formats.keyed import MODEL_KEYS, keyed_camera, numbers, require_read
from dgc_pose.errors import InputError, reason

# Keys that end with their camera. P1 and P2 are of OpenCV's rectified images, and not needed.
_STEREO = re.compile(r"(M|cameraMatrix|K|D|distCoeffs|P)([12])")
_EASYMOCAP = re.compile(r"(K|dist|D|H|W)_(.+)")
_MATRICES = ("M", "cameraMatrix", "K")


def named_rig(data: Mapping[str, Any], path: Path) -> Calibration | None:
    """The cameras of a rig by their names, in the order of the file. Those that are not calibrated,
    as caliscope writes them, are among the names of the `rig` alone. None for other files.

    path: for the identity of the cameras. Raises InputError, with the camera's name, for what is no
    camera and for two of one name; and if none is calibrated.
    """
    tables = _tables(data) or _grouped(data)
    names = {key: str(table.get("name") or key) for key, table in tables.items()}
    parts: dict[str, Camera] = {}
    by_name: dict[str, Camera] = {}
    for key, name in names.items():
        matrix = tables[key].get("matrix")
        held = [] if matrix == "null" else numbers(matrix)
        if held is not None and np.isnan(held).all():
            continue
        try:
            camera = keyed_camera(tables[key], "matrix")
        except (InputError, TypeError, ValueError, OverflowError) as error:
            raise InputError(f"{name}: {reason(error)}") from None
        parts[name] = replace(camera, identity=f"{path} {name}")
        for called in (name, key):
            if by_name.setdefault(called, parts[name]) is not parts[name]:
                raise InputError(f"two cameras have the name {called}")
    if not parts:
        if not tables:
            return None
        raise InputError(f"no matrix of {', '.join(names.values())}")
    is_only = len(tables) == 1 and not _STEREO.fullmatch(name)  # M1 alone is of image 1
    return Calibration("", by_name, parts, parts[name] if is_only else None, rig=(*names.values(),))


def _tables(data: Mapping[str, Any]) -> dict[str, dict[str, Any]]:
    """By their keys, the tables of the cameras in a TOML; caliscope's `cameras` are numbered."""
    listed = data.get("cameras", data)
    tables = {
        str(key): {**({} if listed is data else {"name": f"cam_{key}"}), **table}
        for key, table in (listed.items() if isinstance(listed, Mapping) else ())
        if isinstance(table, Mapping) and not {"matrix", "size"}.isdisjoint(table)
    }
    if not any("distortions" in table for table in tables.values()):
        return {}
    require_read(data, "cameras", *tables)
    return tables


def _grouped(data: Mapping[str, Any]) -> dict[str, dict[str, Any]]:
    """By their names, the cameras of keys that end with them; other keys are of each camera."""
    keys, shared = _EASYMOCAP if "names" in data else _STEREO, {}
    groups: dict[str, dict[str, Any]] = {}
    for key, value in data.items():
        if match := keys.fullmatch(str(key)):
            groups.setdefault(match[2], {})[match[1]] = value
        else:
            shared[key] = value
    tables = {}
    for end, group in groups.items():
        held = [key for key in _MATRICES if key in group and numbers(group[key]) is not None]
        if not held:  # another file, such as one of two cameras with keys of their own
            return {}
        require_read(shared, *MODEL_KEYS)
        name = end if keys is _EASYMOCAP else held[0] + end
        tables[name] = {**shared, "matrix": group.pop(held[0]), **group, "name": name}
    return tables
