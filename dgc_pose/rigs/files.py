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
from dgc_pose.files.json_files import json_text
from dgc_pose.files.outputs import write_text
from dgc_pose.geometry.epipolar import essential_from_pose
from dgc_pose.geometry.rotation import quaternion_wxyz, rotation_vector
from dgc_pose.localization.location import Location
from dgc_pose.model import colmap_camera

# OpenCV's coefficients that hold a lens of COLMAP's: k1, k2, p1, p2, k3, or four of a fisheye.
_OPENCV = {**dict.fromkeys(("SIMPLE_RADIAL", "RADIAL", "OPENCV", "FULL_OPENCV"), 5)}
_OPENCV |= dict.fromkeys(("SIMPLE_RADIAL_FISHEYE", "RADIAL_FISHEYE", "OPENCV_FISHEYE"), 4)
_OPENCV |= dict.fromkeys(("SIMPLE_FISHEYE", "FISHEYE"), 4)
_OF_RIG = ("centre", "covariance", "probability", "rotation_error_90_deg", "position_error_90")
_PLAIN_NAME = re.compile(r"(cameras\.)?[A-Za-z0-9_-]+")  # that TOML takes without quotes


def write_rig(folder: Path, cameras: Mapping[str, Location], unit: str) -> list[Path]:
    """Write the files of a rig into a folder, each whole or not at all, and return their paths.

    cameras: by name, located with the size of the image, or not located. unit: of the positions,
    such as "m".

    - calibration.toml of anipose and Pose2Sim, camera_array.toml of caliscope: x = R X + t;
    - rig_config.json of COLMAP, in the frame of the first camera;
    - stereo.yml of OpenCV, x2 = R x1 + T, if there are two cameras, with lenses of one kind;
    - rig.json: the tables of calibration.toml, the expected errors, why others are not placed, and
      the names of the files.

    A lens that OpenCV does not have is written as COLMAP's `model` and `coefficients`: a program
    that wants `distortions` misses them, and takes no wrong lens. Raises InputError, with the
    camera's name, for a K with a skew; OSError, with the path.
    """
    not_placed = {name: of.reason for name, of in cameras.items() if not of.success}
    cameras = {name: of for name, of in cameras.items() if of.success}
    views = {n: (of.camera, of.cam_from_world) for n, of in cameras.items() if of.camera}
    poses = np.stack([pose for _, pose in views.values() if pose is not None])
    first, R = poses[0], poses[:, :, :3] @ poses[0, :, :3].T
    relative = np.dstack([R, poses[:, :, 3] - R @ first[:, 3]])  # cam_from_first (N, 3, 4)
    rows = zip(views, (camera for camera, _ in views.values()), poses, strict=True)
    tables = {name: _table(name, camera, pose) for name, camera, pose in rows}
    ends = [int(of[0]) if (of := re.search(r"\d+$", name)) else -1 for name in views]
    ids = ends if -1 not in ends and len({*ends}) == len(ends) else range(len(ends))
    listed = {f"cameras.{n}": {"cam_id": n} | t for n, t in zip(ids, tables.values(), strict=True)}
    texts = {
        "calibration.toml": _toml_text(tables | {"metadata": {"unit": unit}}),
        "camera_array.toml": _toml_text(listed),
        "rig_config.json": _colmap_text(views, relative),
    }
    if [table.get("fisheye") for table in tables.values()] in ([False] * 2, [True] * 2):
        texts["stereo.yml"] = _stereo_text([*tables.values()], relative[1])
    for name, location in cameras.items():
        tables[name] |= {key: plain(getattr(location, key)) for key in _OF_RIG}
    data = {"unit": unit, "cameras": tables, "not_placed": not_placed}
    texts["rig.json"] = json_text({**data, "files": [*texts, "rig.json"]})
    for name, text in texts.items():
        write_text(folder / name, text)
    return [folder / name for name in texts]


def _table(name: str, camera: Camera, pose: np.ndarray) -> dict[str, Any]:
    """What calibration.toml has of a camera."""
    lens = camera.distortion or Distortion("OPENCV", (0.0,) * 4)
    count = _OPENCV.get(lens.model, 0)
    of_lens: dict[str, Any] = {"model": lens.model, "coefficients": lens.coefficients}
    if count and not any(lens.coefficients[count:]):
        values = [*lens.coefficients, *[0.0] * count]
        of_lens = {"distortions": values[:count], "fisheye": count == 4}
    return {
        "name": name,
        "size": camera.size,
        "matrix": camera.K.tolist(),
        **of_lens,
        "rotation": rotation_vector(pose[:, :3]).tolist(),
        "translation": pose[:, 3].tolist(),
        "focal_std": camera.focal_std,
    }


def _colmap_text(views: Mapping[str, tuple[Camera, Any]], relative: np.ndarray) -> str:
    rows: list[dict[str, Any]] = []
    for (name, (camera, _)), pose in zip(views.items(), relative, strict=True):
        of_rig = {
            "cam_from_rig_rotation": quaternion_wxyz(pose[:, :3]).tolist(),
            "cam_from_rig_translation": pose[:, 3].tolist(),
        }
        theirs = colmap_camera(camera, name)
        intrinsics = {"camera_model_name": theirs.model.name, "camera_params": [*theirs.params]}
        in_rig = of_rig if rows else {"ref_sensor": True}
        rows.append({"image_prefix": f"{name}/", **in_rig, **intrinsics})
    return json.dumps([{"cameras": rows}], indent=2) + "\n"


def _stereo_text(tables: Sequence[Mapping[str, Any]], pose: np.ndarray) -> str:
    R, T = pose[:, :3], pose[:, 3]
    E, (K1, K2) = essential_from_pose(R, T), (np.array(table["matrix"]) for table in tables)
    values = {"R": R, "T": T[:, None], "E": E, "F": np.linalg.inv(K2).T @ E @ np.linalg.inv(K1)}
    for number, table in enumerate(tables, start=1):
        values[f"M{number}"] = np.array(table["matrix"])
        values[f"D{number}"] = np.array([table["distortions"]])
    if tables[0]["size"] == tables[1]["size"]:
        values["image_width"], values["image_height"] = tables[0]["size"]
    values["fisheye_model"] = int(tables[0]["fisheye"])
    storage = cv2.FileStorage(".yml", cv2.FILE_STORAGE_WRITE | cv2.FILE_STORAGE_MEMORY)
    for key, value in values.items():
        storage.write(key, value)
    text: str = storage.releaseAndGetString()
    return text


def _toml_text(tables: Mapping[str, Mapping[str, Any]]) -> str:
    """A TOML of tables whose values are those of JSON."""
    lines = []
    for name, table in tables.items():
        quoted = name if _PLAIN_NAME.fullmatch(name) else json.dumps(name, ensure_ascii=False)
        lines.append(f"[{quoted}]")
        values = {key: json.dumps(value, ensure_ascii=False) for key, value in table.items()}
        lines += [*(f"{key} = {value}" for key, value in values.items()), ""]
    return "\n".join(lines)
