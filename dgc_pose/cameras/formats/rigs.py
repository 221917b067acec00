"""Files that name the cameras of a rig, with or without their poses.

Read and written: OpenCV's file of a stereo pair, the TOML of anipose, caliscope and Pose2Sim, and
COLMAP's rig_config.json. Only read: EasyMocap's intri.yml, Kalibr's camchain, EuRoC's sensor.yaml.
`dgc-pose rig` also writes rig.json, which names the TOML.
"""

import json
import re
from collections.abc import Mapping, Sequence
from contextlib import suppress
from dataclasses import replace
from pathlib import Path, PurePath
from typing import Any

import cv2
import numpy as np

from dgc_pose.cameras.by_image import Calibration
from dgc_pose.cameras.camera import Camera, colmap_camera
from dgc_pose.cameras.colmap_camera import Distortion, intrinsics
from dgc_pose.cameras.formats.keyed import keyed_camera, numbers, unread
from dgc_pose.cameras.formats.opened import CameraFile
from dgc_pose.errors import InputError, reason
from dgc_pose.geometry.epipolar import essential_from_pose, fundamental_from_essential
from dgc_pose.geometry.rotation import is_rotation, quaternion_wxyz, rotation_of_quaternion

# Keys that end with the name of their camera. P1 and P2 describe OpenCV's rectified images: unused.
_STEREO = re.compile(r"(M|cameraMatrix|K|D|distCoeffs|P)([12])")
_EASYMOCAP = re.compile(r"(K|dist|D|H|W)_(.+)")
_MATRICES = ("M", "cameraMatrix", "K")
CALIBRATION = "calibration.toml"
# Number of OpenCV's coefficients for a lens of COLMAP: k1 k2 p1 p2 k3, or k1 to k4.
_OPENCV = dict.fromkeys(("SIMPLE_RADIAL", "RADIAL", "OPENCV", "FULL_OPENCV"), 5)
_OPENCV |= {f"{kind}FISHEYE": 4 for kind in ("", "SIMPLE_", "RADIAL_", "SIMPLE_RADIAL_", "OPENCV_")}


def read(file: CameraFile) -> Calibration | None:
    """The cameras of a rig by name, in the file's order, and their poses; None for other files.

    Uncalibrated cameras, which caliscope writes, appear only in `rig`. Raises InputError, with the
    camera's name, for an invalid camera, a pose that is not rigid, and two cameras with one name;
    and if no camera is calibrated.
    """
    data = file.data
    if not isinstance(data, Mapping):
        return None
    return calibration(_kalibr(data) or _tables(data) or _grouped(data), file.path)


def read_colmap(file: CameraFile) -> Calibration | None:
    """The cameras of COLMAP's rig_config.json by the last folder of their image_prefix, and their
    poses; None for other files. Several rigs have no common frame, so they get no poses.

    Raises as `read` does.
    """
    rigs = file.data
    if not isinstance(rigs, list) or not rigs:
        return None
    if not all(isinstance(rig, Mapping) and rig.get("cameras") for rig in rigs):
        return None
    tables = {}
    for camera in (camera for rig in rigs for camera in rig["cameras"]):
        prefix = PurePath(str(camera["image_prefix"]))
        first = camera.get("ref_sensor")
        table: dict[str, Any] = {"name": prefix.name}
        if len(rigs) == 1:
            table["rotation"] = [1, 0, 0, 0] if first else camera.get("cam_from_rig_rotation")
            table["translation"] = [0, 0, 0] if first else camera.get("cam_from_rig_translation")
        if "camera_params" in camera:
            values = numbers(camera["camera_params"]) or []
            K, lens = intrinsics(str(camera["camera_model_name"]), values)
            table |= {"matrix": K.tolist(), **({} if lens is None else vars(lens))}
        tables[str(prefix)] = table
    return calibration(tables, file.path)


def calibration(tables: Mapping[str, Mapping[str, Any]], path: Path) -> Calibration | None:
    """The cameras from tables in the form of calibration.toml; None without a table. If all cameras
    are equal, they are also the common camera. Raises as `read` does."""
    names = {key: str(table.get("name") or key) for key, table in tables.items()}
    parts: dict[str, Camera] = {}
    poses: dict[str, np.ndarray] = {}
    for key, name in names.items():
        matrix = tables[key].get("matrix")
        held = [] if matrix == "null" else numbers(matrix)
        if held is not None and np.isnan(held).all():
            continue
        try:
            camera = keyed_camera(tables[key], "matrix")
            pose = _pose(tables[key])
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
    kinds = {(camera.K.tobytes(), camera.distortion) for camera in parts.values()}
    is_one = len(kinds) == 1 and len(parts) == len(tables)
    is_one &= not _STEREO.fullmatch(name)  # a single M1 is only for image 1
    common = next(iter(parts.values())) if is_one else None
    rig = (*names.values(),)
    return Calibration("", by_name, parts, common, poses=poses, rig=rig)


def _pose(table: Mapping[str, Any]) -> np.ndarray | None:
    """cam_from_world [R | t] (3, 4) from a rotation matrix, rotation vector or quaternion; None if
    the table has no pose."""
    values, t = (np.array(numbers(table.get(key)) or ()) for key in ("rotation", "translation"))
    if not len(values) or not len(t) or np.isnan([*values, *t]).all():
        return None
    with suppress(ValueError):
        R = rotation_of_quaternion(values) if len(values) == 4 else values
        R = cv2.Rodrigues(values)[0] if len(values) == 3 else R.reshape(3, 3)
        pose = np.column_stack([R, t])
        if np.isfinite(pose).all() and is_rotation(pose[:, :3]):
            return pose
    raise InputError("rotation and translation are not a rigid pose")


def _kalibr(data: Mapping[str, Any]) -> dict[str, dict[str, Any]]:
    """The tables of Kalibr's camchain by camera name; that of EuRoC's sensor.yaml as "cam0"."""
    tables = {}
    for name, values in {**data, "cam0": data.get("cam0", data)}.items():
        if not isinstance(values, Mapping) or not numbers(values.get("intrinsics")):
            continue
        table = {"name": str(name), "distortion_model": "none", **values}
        table["matrix"] = table.pop("intrinsics")
        table["size"] = table.pop("resolution", None)
        tables[str(name)] = table

    if not tables or "intrinsics" in data:
        return tables
    others = dict.fromkeys(unread(data, *tables), "unread")
    return {name: others | table for name, table in tables.items()}


def _tables(data: Mapping[str, Any]) -> dict[str, dict[str, Any]]:
    """The tables of the cameras in a TOML by key; caliscope's `cameras` are numbered."""
    listed = data.get("cameras", data)
    if not isinstance(listed, Mapping):
        return {}
    tables = {}
    for key, table in listed.items():
        if isinstance(table, Mapping) and not {"matrix", "size"}.isdisjoint(table):
            numbered = {} if listed is data else {"name": f"cam_{key}"}
            tables[str(key)] = {**numbered, **table}
    lenses = [{"distortions"}, {"matrix", "coefficients"}]
    if not any(lens <= table.keys() for table in tables.values() for lens in lenses):
        return {}
    others = dict.fromkeys(unread(data, "cameras", *tables), "unread")
    return {name: others | table for name, table in tables.items()}


def _matrix_key(group: Mapping[str, Any]) -> str | None:
    for key in _MATRICES:
        if key in group and numbers(group[key]) is not None:
            return key
    return None


def _grouped(data: Mapping[str, Any]) -> dict[str, dict[str, Any]]:
    """The cameras by name, from keys that end with the name; other keys apply to each camera."""
    keys = _EASYMOCAP if "names" in data else _STEREO
    shared = {}
    groups: dict[str, dict[str, Any]] = {}
    for key, value in data.items():
        if match := keys.fullmatch(str(key)):
            groups.setdefault(match[2], {})[match[1]] = value
        else:
            shared[key] = value

    tables = {}
    for end, group in groups.items():
        matrix = _matrix_key(group)
        if matrix is None:  # another format
            return {}
        name = end if keys is _EASYMOCAP else matrix + end
        tables[name] = {**shared, "matrix": group.pop(matrix), **group, "name": name}

    if keys is _STEREO and len(tables) == 2 and {"R", "T"} <= shared.keys():
        first, second = (tables[name] for name in sorted(tables, key=lambda name: name[-1]))
        first |= {"rotation": np.eye(3), "translation": np.zeros(3)}
        second |= {"rotation": shared["R"], "translation": shared["T"]}
    return tables


def rig_texts(cameras: Mapping[str, Camera], poses: np.ndarray, unit: str) -> dict[str, str]:
    """The text of each rig file by file name.

    cameras: by name, with a size. poses: their cam_from_world (N, 3, 4). unit: of the positions; ""
    up to scale.

    - calibration.toml of anipose and Pose2Sim, camera_array.toml of caliscope: x = R X + t;
    - rig_config.json of COLMAP, in the frame of the first camera;
    - stereo.yml of OpenCV, x2 = R x1 + T, for two cameras with lenses of one kind.

    A lens that OpenCV does not have is written as COLMAP's `model` and `coefficients`, so that a
    program that reads `distortions` fails instead of using a wrong lens. Raises InputError, with
    the camera's name, for a K with a skew.
    """
    in_rig = poses @ np.linalg.inv(np.vstack([poses[0], [0, 0, 0, 1]]))  # cam_from_first (N, 3, 4)
    rows = zip(cameras.items(), poses, strict=True)
    tables = {name: _table(name, camera, pose) for (name, camera), pose in rows}
    quoted = {json.dumps(name, ensure_ascii=False): table for name, table in tables.items()}
    ends = [int(end) for name in cameras for end in re.findall(r"\d+$", name)]
    ids = ends if len({*ends}) == len(cameras) else range(len(cameras))
    listed = zip(ids, tables.values(), strict=True)
    texts = {
        CALIBRATION: _toml_text({**quoted, "metadata": {"unit": unit}}),
        "camera_array.toml": _toml_text({f"cameras.{n}": {"cam_id": n, **t} for n, t in listed}),
        "rig_config.json": _colmap_text(cameras, in_rig),
    }
    if [table.get("fisheye") for table in tables.values()] in ([False] * 2, [True] * 2):
        texts["stereo.yml"] = _stereo_text([*tables.values()], in_rig[1])
    return texts


def _table(name: str, camera: Camera, pose: np.ndarray) -> dict[str, Any]:
    """The table of a camera in calibration.toml."""
    lens = camera.distortion or Distortion("OPENCV", (0.0,) * 4)
    count = _OPENCV.get(lens.model, 0)
    values = [*lens.coefficients, *[0.0] * count]
    lens_values: dict[str, Any] = {"distortions": values[:count], "fisheye": count == 4}
    if not count or any(values[count:]):
        lens_values = {"model": lens.model, "coefficients": lens.coefficients}
    w, *axis = quaternion_wxyz(pose[:, :3])  # cv2.Rodrigues: only 7 digits near a half turn
    half = np.arctan2(np.linalg.norm(axis), w)
    return {
        "name": name,
        "size": camera.size,
        "matrix": camera.K.tolist(),
        **lens_values,
        "rotation": (2 * np.array(axis) / np.sinc(half / np.pi)).tolist(),
        "translation": pose[:, 3].tolist(),
        "focal_std": camera.focal_std,
    }


def _colmap_text(cameras: Mapping[str, Camera], poses: np.ndarray) -> str:
    rows: list[Mapping[str, Any]] = []
    for (name, camera), pose in zip(cameras.items(), poses, strict=True):
        theirs = colmap_camera(camera, name)
        row: dict[str, Any] = {"image_prefix": f"{name}/"}
        row |= {"camera_model_name": theirs.model.name, "camera_params": theirs.params.tolist()}
        if rows:
            row["cam_from_rig_rotation"] = quaternion_wxyz(pose[:, :3]).tolist()
            row["cam_from_rig_translation"] = pose[:, 3].tolist()
        else:
            row["ref_sensor"] = True
        rows.append(row)
    return json.dumps([{"cameras": rows}], indent=2) + "\n"


def _stereo_text(tables: Sequence[Mapping[str, Any]], pose: np.ndarray) -> str:
    K1, K2 = (np.array(table["matrix"]) for table in tables)
    R = pose[:, :3]
    T = pose[:, 3:]
    D1, D2 = (np.array([table["distortions"]]) for table in tables)
    F = fundamental_from_essential(E := essential_from_pose(R, T[:, 0]), K1, K2)
    values: dict[str, Any] = {"M1": K1, "D1": D1, "M2": K2, "D2": D2}
    values |= {"R": R, "T": T, "E": E, "F": F, "fisheye_model": int(tables[0]["fisheye"])}
    if tables[0]["size"] == tables[1]["size"]:
        values["image_width"], values["image_height"] = tables[0]["size"]
    storage = cv2.FileStorage(".yml", cv2.FILE_STORAGE_WRITE | cv2.FILE_STORAGE_MEMORY)
    for key, value in values.items():
        storage.write(key, value)
    return str(storage.releaseAndGetString())


def _toml_text(tables: Mapping[str, Mapping[str, Any]]) -> str:
    """A TOML of tables whose values are written as in JSON."""
    lines = []
    for name, table in tables.items():
        values = [
            f"{key} = {json.dumps(value, ensure_ascii=False)}" for key, value in table.items()
        ]
        lines += [f"[{name}]", *values, ""]
    return "\n".join(lines)
