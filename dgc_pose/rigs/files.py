"""The files of a rig of fixed cameras, in the layouts that other programs read."""

import json
import re
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

import cv2
import numpy as np

from dgc_pose.cameras.camera import Camera
from dgc_pose.cameras.colmap_camera import Distortion
from dgc_pose.estimation.result import plain
from dgc_pose.geometry.epipolar import essential_from_pose, fundamental_from_essential
from dgc_pose.geometry.rotation import quaternion_wxyz
from dgc_pose.localization.location import Location
from dgc_pose.model import colmap_camera
from dgc_pose.system.files import write_text
from dgc_pose.system.texts import json_text

# How many of OpenCV's coefficients hold a lens of COLMAP's: k1 k2 p1 p2 k3, or k1 to k4.
_OPENCV = dict.fromkeys(("SIMPLE_RADIAL", "RADIAL", "OPENCV", "FULL_OPENCV"), 5)
_OPENCV |= {f"{kind}FISHEYE": 4 for kind in ("", "SIMPLE_", "RADIAL_", "SIMPLE_RADIAL_", "OPENCV_")}
FILES = ("calibration.toml", "camera_array.toml", "rig_config.json", "stereo.yml", "rig.json")
_OF_RIG = ("centre", "covariance", "probability", "rotation_error_90_deg", "position_error_90")


def write_rig(
    folder: Path, cameras: Mapping[str, Location], metric: Mapping[str, Any]
) -> list[Path]:
    """Write the files of a rig into a folder, each whole or not at all, and return their paths.

    cameras: by name, located with the size of the image, or not located. metric: the unit of the
    positions, and facts about it; empty up to scale.

    - calibration.toml of anipose and Pose2Sim, camera_array.toml of caliscope: x = R X + t;
    - rig_config.json of COLMAP, in the frame of the first camera;
    - stereo.yml of OpenCV, x2 = R x1 + T, if there are two cameras, with lenses of one kind;
    - rig.json: the tables of calibration.toml, the expected errors, why others are not placed, and
      the names of the files.

    A lens that OpenCV does not have is written as COLMAP's `model` and `coefficients`: a program
    that wants `distortions` misses them, and takes no wrong lens. Raises InputError, with the
    camera's name, for a K with a skew; OSError, with the path.
    """
    views = {name: of.camera for name, of in cameras.items() if of.success and of.camera}
    not_placed = {name: of.reason for name, of in cameras.items() if not of.success}
    if not views:
        data = {"unit": "", "cameras": {}, "not_placed": not_placed, "files": ["rig.json"]}
        write_text(folder / "rig.json", json_text(data))
        return [folder / "rig.json"]
    stated = (cameras[name].cam_from_world for name in views)
    poses = np.stack([pose for pose in stated if pose is not None])
    in_rig = poses @ np.linalg.inv(np.vstack([poses[0], [0, 0, 0, 1]]))  # cam_from_first (N, 3, 4)
    rows = zip(views.items(), poses, strict=True)
    tables = {name: _table(name, camera, pose) for (name, camera), pose in rows}
    quoted = {json.dumps(name, ensure_ascii=False): table for name, table in tables.items()}
    ends = [int(end) for name in views for end in re.findall(r"\d+$", name)]
    ids = ends if len({*ends}) == len(views) else range(len(views))
    listed = zip(ids, tables.values(), strict=True)
    texts = {
        "calibration.toml": _toml_text({**quoted, "metadata": {"unit": metric.get("unit", "")}}),
        "camera_array.toml": _toml_text({f"cameras.{n}": {"cam_id": n, **t} for n, t in listed}),
        "rig_config.json": _colmap_text(views, in_rig),
    }
    if [table.get("fisheye") for table in tables.values()] in ([False] * 2, [True] * 2):
        texts["stereo.yml"] = _stereo_text([*tables.values()], in_rig[1])
    for name, table in tables.items():
        table |= {key: plain(getattr(cameras[name], key)) for key in _OF_RIG}
    data = {"unit": "", **metric, "cameras": tables, "not_placed": not_placed}
    texts["rig.json"] = json_text({**data, "files": [*texts, "rig.json"]})
    for name, text in texts.items():
        write_text(folder / name, text)
    return [folder / name for name in texts]


def _table(name: str, camera: Camera, pose: np.ndarray) -> dict[str, Any]:
    """What calibration.toml has of a camera."""
    lens = camera.distortion or Distortion("OPENCV", (0.0,) * 4)
    count = _OPENCV.get(lens.model, 0)
    values = [*lens.coefficients, *[0.0] * count]
    of_lens: dict[str, Any] = {"distortions": values[:count], "fisheye": count == 4}
    if not count or any(values[count:]):
        of_lens = {"model": lens.model, "coefficients": lens.coefficients}
    w, *axis = quaternion_wxyz(pose[:, :3])  # cv2.Rodrigues has 7 digits near a half turn
    half = np.arctan2(np.linalg.norm(axis), w)
    return {
        "name": name,
        "size": camera.size,
        "matrix": camera.K.tolist(),
        **of_lens,
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
    (K1, K2), R, T = (np.array(table["matrix"]) for table in tables), pose[:, :3], pose[:, 3:]
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
    """A TOML of tables whose values are those of JSON."""
    lines = []
    for name, table in tables.items():
        values = [f"{key} = {json.dumps(of, ensure_ascii=False)}" for key, of in table.items()]
        lines += [f"[{name}]", *values, ""]
    return "\n".join(lines)
