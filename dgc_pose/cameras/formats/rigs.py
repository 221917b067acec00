"""Files that name the cameras of a rig, with their poses if the file has them: OpenCV's of a stereo
pair, EasyMocap's intri.yml, the TOML of anipose, caliscope and Pose2Sim, COLMAP's rig_config.json,
and rig.json, which has the tables of the TOML.
"""

import re
from collections.abc import Mapping, Sequence
from contextlib import suppress
from dataclasses import replace
from pathlib import Path, PurePath
from typing import Any

import cv2
import numpy as np

from dgc_pose.cameras.by_image import Calibration
from dgc_pose.cameras.camera import Camera
from dgc_pose.cameras.colmap_camera import intrinsics
from dgc_pose.cameras.formats.keyed import MODEL_KEYS, keyed_camera, numbers, require_read
from dgc_pose.errors import InputError, reason
from dgc_pose.geometry.rotation import is_rotation, rotation_of_quaternion

# Keys that end with their camera. P1 and P2 are of OpenCV's rectified images, and not needed.
_STEREO = re.compile(r"(M|cameraMatrix|K|D|distCoeffs|P)([12])")
_EASYMOCAP = re.compile(r"(K|dist|D|H|W)_(.+)")
_MATRICES = ("M", "cameraMatrix", "K")


def named_rig(data: Mapping[str, Any], path: Path) -> Calibration | None:
    """The cameras of a rig by their names, in the order of the file, and their poses. Cameras that
    are not calibrated, as caliscope writes them, are among the names of the `rig` alone. None for
    other files.

    path: for the identity of the cameras. Raises InputError, with the camera's name, for what is no
    camera or no rigid pose, and for two cameras of one name; and if no camera is calibrated.
    """
    return _calibration(_tables(data) or _grouped(data), path)


def colmap_rig(rigs: Sequence[Any], path: Path) -> Calibration | None:
    """The cameras of COLMAP's rig_config.json by the last folder of their image_prefix, and their
    poses, unless the file has several rigs, which have no common frame. None for other lists.

    Raises as `named_rig` does.
    """
    if not rigs or not all(isinstance(rig, Mapping) and rig.get("cameras") for rig in rigs):
        return None
    tables = {}
    for camera in (camera for rig in rigs for camera in rig["cameras"]):
        prefix, first = PurePath(str(camera["image_prefix"])), camera.get("ref_sensor")
        table: dict[str, Any] = {"name": prefix.name}
        if len(rigs) == 1:
            table["rotation"] = [1, 0, 0, 0] if first else camera.get("cam_from_rig_rotation")
            table["translation"] = [0, 0, 0] if first else camera.get("cam_from_rig_translation")
        if "camera_params" in camera:
            values = numbers(camera["camera_params"]) or []
            K, lens = intrinsics(str(camera["camera_model_name"]), values)
            table |= {"matrix": K.tolist(), **({} if lens is None else vars(lens))}
        tables[str(prefix)] = table
    return _calibration(tables, path)


def _calibration(tables: Mapping[str, Mapping[str, Any]], path: Path) -> Calibration | None:
    names = {key: str(table.get("name") or key) for key, table in tables.items()}
    parts: dict[str, Camera] = {}
    poses: dict[str, np.ndarray] = {}
    for key, name in names.items():
        matrix = tables[key].get("matrix")
        held = [] if matrix == "null" else numbers(matrix)
        if held is not None and np.isnan(held).all():
            continue
        try:
            camera, pose = keyed_camera(tables[key], "matrix"), _pose(tables[key])
        except (InputError, TypeError, ValueError, OverflowError) as error:
            raise InputError(f"{name}: {reason(error)}") from None
        if name in parts:
            raise InputError(f"two cameras have the name {name}")
        parts[name] = replace(camera, identity=f"{path} {name}")
        if pose is not None:
            poses[name] = pose
    if not parts:
        if not tables:
            return None
        raise InputError(f"no matrix of {', '.join(names.values())}")
    by_name = {key: parts[name] for key, name in names.items() if name in parts} | parts
    is_only = len(tables) == 1 and not _STEREO.fullmatch(name)  # M1 alone is of image 1
    common, rig = parts[name] if is_only else None, (*names.values(),)
    return Calibration("", by_name, parts, common, poses=poses, rig=rig)


def _pose(table: Mapping[str, Any]) -> np.ndarray | None:
    """cam_from_world [R | t] (3, 4), the rotation a matrix, a rotation vector or a quaternion; None
    of a camera without a pose."""
    values, t = (np.array(numbers(table.get(key)) or ()) for key in ("rotation", "translation"))
    if not len(values) or not len(t) or np.isnan([*values, *t]).all():
        return None
    with suppress(ValueError):
        R = rotation_of_quaternion(values) if len(values) == 4 else values
        R = cv2.Rodrigues(values)[0] if len(values) == 3 else R.reshape(3, 3)
        pose = np.column_stack([R, t])
        if np.isfinite(pose).all() and is_rotation(pose[:, :3]):
            return pose
    raise InputError("rotation and translation are no rigid pose")


def _tables(data: Mapping[str, Any]) -> dict[str, dict[str, Any]]:
    """By their keys, the tables of the cameras in a TOML; caliscope's `cameras` are numbered."""
    listed = data.get("cameras", data)
    tables = {
        str(key): {**({} if listed is data else {"name": f"cam_{key}"}), **table}
        for key, table in (listed.items() if isinstance(listed, Mapping) else ())
        if isinstance(table, Mapping) and not {"matrix", "size"}.isdisjoint(table)
    }
    lenses = [{"distortions"}, {"matrix", "coefficients"}]
    if not any(lens <= table.keys() for table in tables.values() for lens in lenses):
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
    if keys is _STEREO and len(tables) == 2 and {"R", "T"} <= shared.keys():
        first, second = (tables[name] for name in sorted(tables, key=lambda name: name[-1]))
        first |= {"rotation": np.eye(3), "translation": np.zeros(3)}
        second |= {"rotation": shared["R"], "translation": shared["T"]}
    return tables
