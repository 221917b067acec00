"""The files of a rig of fixed cameras, in the layouts that other programs read.

All hold cam_from_world, x = R X + t, and (0, 0) at the centre of the top-left pixel, but for
COLMAP's, which have (0.5, 0.5) there.
"""

import json
import re
from collections.abc import Callable, Mapping
from pathlib import Path
from typing import Any

import cv2
import numpy as np

from dgc_pose.cameras.camera import Camera
from dgc_pose.cameras.colmap_camera import Distortion
from dgc_pose.errors import InputError
from dgc_pose.estimation.result import plain
from dgc_pose.files.json_files import json_text
from dgc_pose.files.outputs import write_text
from dgc_pose.geometry.epipolar import essential_from_pose
from dgc_pose.geometry.rotation import quaternion_wxyz, rotation_vector
from dgc_pose.localization.location import Location
from dgc_pose.model import colmap_camera

ANIPOSE, CALISCOPE, STEREO = "calibration.toml", "camera_array.toml", "stereo.yml"
COLMAP, RIG = "rig_config.json", "rig.json"
_DIGITS = re.compile(r"\d+$")
_TABLE = re.compile(r"(cameras\.)?[A-Za-z0-9_-]+")  # needs no quotes
_FISHEYES = ("OPENCV_FISHEYE", "SIMPLE_RADIAL_FISHEYE", "RADIAL_FISHEYE", "FISHEYE")
_FISHEYES += ("SIMPLE_FISHEYE",)  # the same lens with fewer coefficients
_PLANES = ("SIMPLE_RADIAL", "RADIAL", "OPENCV", "FULL_OPENCV")  # of k1, k2, p1, p2, k3, ...


def write_rig(folder: Path, cameras: Mapping[str, Location], unit: str) -> list[Path]:
    """Write the files of a rig into a folder, each whole or not at all, and return their paths.

    cameras: by name, located, with the size of the image; at least one. unit: of the positions,
    such as "m".

    - calibration.toml, of anipose and Pose2Sim; camera_array.toml, of caliscope;
    - stereo.yml, of OpenCV, if there are two cameras: x2 = R x1 + T;
    - rig_config.json, of COLMAP: poses in the axes of the first camera;
    - rig.json, with everything, and why a file is left out.

    A file is left out if it cannot hold a camera. Raises OSError, with the path, and InputError if
    another process writes the file.
    """
    forms: dict[str, Callable[[], str]] = {
        ANIPOSE: lambda: _toml_text(_opencv_tables(cameras) | {"metadata": {"unit": unit}}),
        CALISCOPE: lambda: _toml_text(_caliscope_tables(cameras)),
        COLMAP: lambda: json.dumps([{"cameras": _colmap_cameras(cameras)}], indent=2) + "\n",
    }
    if len(cameras) == 2:
        forms[STEREO] = lambda: _stereo_text(cameras)
    texts, left_out = {}, {}
    for name, text in forms.items():
        try:
            texts[name] = text()
        except InputError as error:
            left_out[name] = str(error)
    rows = {name: _everything(name, location) for name, location in cameras.items()}
    files = {"files": [*texts, RIG], "left_out": left_out}
    texts[RIG] = json_text({"unit": unit, "cameras": rows, **files})
    for name, text in texts.items():
        write_text(folder / name, text)
    return [folder / name for name in texts]


def opencv_lens(camera: Camera) -> tuple[list[float], bool]:
    """k1, k2, p1, p2, k3 of a lens, and whether it is a fisheye, which has k1, k2, k3, k4.

    Raises InputError for a lens of more coefficients or another model, and for a K with a skew.
    """
    lens = camera.distortion
    if camera.K[0, 1]:
        raise InputError(f"K has a skew of {camera.K[0, 1]:g}, which OpenCV does not have")
    if lens is None:
        return [0.0] * 5, False
    is_fisheye, values = lens.model in _FISHEYES, [*lens.coefficients, *[0.0] * 5]
    count = 4 if is_fisheye else 5
    if not (is_fisheye or lens.model in _PLANES) or any(values[count:]):
        raise InputError(f"the lens {lens.model} is none of {count} OpenCV coefficients")
    return values[:count], is_fisheye


def _opencv_tables(cameras: Mapping[str, Location]) -> dict[str, dict[str, Any]]:
    """By camera name, what calibration.toml has of it."""
    tables = {}
    for name, location in cameras.items():
        try:
            lens, is_fisheye = opencv_lens(_camera(location))
        except InputError as error:
            raise InputError(f"{name}: {error}") from None
        tables[name] = {**_pinhole(name, location), "distortions": lens, "fisheye": is_fisheye}
    return tables


def _caliscope_tables(cameras: Mapping[str, Location]) -> dict[str, dict[str, Any]]:
    """By `cameras.ID`: the numbers that end the names, or else those of the order."""
    tables = _opencv_tables(cameras)
    ends = [match and int(match[0]) for match in map(_DIGITS.search, tables)]
    ids = ends if None not in ends and len({*ends}) == len(ends) else range(len(ends))
    return {f"cameras.{n}": {"cam_id": n} | of for n, of in zip(ids, tables.values(), strict=True)}


def _everything(name: str, location: Location) -> dict[str, Any]:
    """What rig.json has of a camera: the keys of calibration.toml, or those of a lens of COLMAP's
    that OpenCV does not have, and the rest."""
    camera = _camera(location)
    try:
        of_lens = _opencv_tables({name: location})[name]
    except InputError:
        lens = camera.distortion or Distortion("PINHOLE")  # of a K with a skew
        of_lens = {"model": lens.model, "coefficients": lens.coefficients}
    names = ("centre", "covariance", "probability", "rotation_error_90_deg", "position_error_90")
    return {
        **_pinhole(name, location),
        **of_lens,
        "focal_std": camera.focal_std,
        "centre_std_px": camera.centre_std,
        **{key: plain(getattr(location, key)) for key in names},
    }


def _stereo_text(cameras: Mapping[str, Location]) -> str:
    """OpenCV's stereo file, x2 = R x1 + T, as YAML. Raises InputError if one lens is a fisheye."""
    tables, (first, second) = _opencv_tables(cameras), map(_pose, cameras.values())
    if len({table["fisheye"] for table in tables.values()}) > 1:
        raise InputError(f"one of {' and '.join(tables)} is a fisheye, the other is not")
    R = second[:, :3] @ first[:, :3].T
    T = second[:, 3] - R @ first[:, 3]
    E = essential_from_pose(R, T)
    K1, K2 = (np.array(table["matrix"]) for table in tables.values())
    values = {"R": R, "T": T[:, None], "E": E, "F": np.linalg.inv(K2).T @ E @ np.linalg.inv(K1)}
    for number, (name, table) in enumerate(tables.items(), start=1):
        lens = np.array([table["distortions"]])
        values |= {
            f"name{number}": name,
            f"M{number}": np.array(table["matrix"]),
            f"D{number}": lens,
        }
    if len(sizes := {tuple(table["size"]) for table in tables.values()}) == 1:
        values["image_width"], values["image_height"] = sizes.pop()
    if table["fisheye"]:
        values["fisheye_model"] = 1
    mode = cv2.FILE_STORAGE_WRITE | cv2.FILE_STORAGE_MEMORY
    storage = cv2.FileStorage(".yml", mode)
    for key, value in values.items():
        storage.write(key, value)
    text: str = storage.releaseAndGetString()
    return text


def _colmap_cameras(cameras: Mapping[str, Location]) -> list[dict[str, Any]]:
    """The first camera is the reference, in whose axes the others' poses are."""
    first, *_ = map(_pose, cameras.values())
    rows = []
    for name, location in cameras.items():
        camera, pose = colmap_camera(_camera(location), name), _pose(location)
        row = {
            "image_prefix": f"{name}/",
            "camera_model_name": camera.model.name,
            "camera_params": camera.params.tolist(),
        }
        R = pose[:, :3] @ first[:, :3].T
        of_rig = {
            "cam_from_rig_rotation": quaternion_wxyz(R).tolist(),
            "cam_from_rig_translation": (pose[:, 3] - R @ first[:, 3]).tolist(),
        }
        rows.append(row | (of_rig if rows else {"ref_sensor": True}))
    return rows


def _pinhole(name: str, location: Location) -> dict[str, Any]:
    """A camera without its lens, by the keys of calibration.toml."""
    camera, pose = _camera(location), _pose(location)
    assert camera.size is not None
    return {
        "name": name,
        "size": [int(side) for side in camera.size],
        "matrix": camera.K.tolist(),
        "rotation": rotation_vector(pose[:, :3]).tolist(),
        "translation": pose[:, 3].tolist(),
    }


def _camera(location: Location) -> Camera:
    assert location.camera is not None
    return location.camera


def _pose(location: Location) -> np.ndarray:
    pose = location.cam_from_world
    assert pose is not None
    return pose


def _toml_text(tables: Mapping[str, Mapping[str, Any]]) -> str:
    """A TOML of tables whose values are those of JSON."""
    lines = []
    for name, table in tables.items():
        lines.append(f"[{name if _TABLE.fullmatch(name) else _json(name)}]")
        lines += [f"{key} = {_json(value)}" for key, value in table.items()] + [""]
    return "\n".join(lines)


def _json(value: Any) -> str:
    return json.dumps(value, ensure_ascii=False, allow_nan=False)
