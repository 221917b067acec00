"""Cameras in files with keys: OpenCV's cv::FileStorage, ROS's camera_info, tables, and the JSON of
`camera_data`.

An unread key that may describe the lens raises InputError: without it, the pose would be silently
wrong. An unread key that may describe another camera causes a warning. cv::FileStorage is not used
to read files: a damaged file of a few hundred bytes ends the process.
"""

import csv
import re
from collections.abc import Mapping, Sequence
from contextlib import suppress
from dataclasses import replace
from typing import Any

import numpy as np

from dgc_pose.cameras.by_image import Calibration
from dgc_pose.cameras.camera import Camera, matrix_camera
from dgc_pose.cameras.colmap_camera import Distortion
from dgc_pose.cameras.formats.opened import CameraFile
from dgc_pose.errors import InputError, reason, shortened
from dgc_pose.geometry.pixels import Size
from dgc_pose.geometry.rotation import rotation_of_quaternion
from dgc_pose.system.arrays import read_array

# Names of the matrix and the size in files of OpenCV's programs, ROS, Kalibr, Open3D and Record3D.
# In ROS, `camera_matrix` and the distortion describe the raw image.
_MATRICES = ("camera_matrix", "cameraMatrix", "Camera_Matrix", "K", "k", "intrinsic_matrix")
_SIZES = (
    *(("size",), ("image_size",), ("imageSize",), ("cameraResolution",)),
    *(("image_width", "image_height"), ("image_Width", "image_Height"), ("width", "height")),
    *(("w", "h"), ("W", "H")),
)
_FOUR = ("fx", "fy", "cx", "cy")
_POSE = ("qw", "qx", "qy", "qz", "tx", "ty", "tz")
_CAMERAS_OF_A_PAIR = {"K1": "K1", "K2": "K2", "camera1": "K1", "camera2": "K2"}
_MODEL_KEYS = ("camera_model", "distortion_model", "fisheye_model", "is_fisheye", "fisheye")
_MODELS = {  # of OpenCV and NeRF, ROS, Kalibr; 0 and 1 are values of a flag
    **dict.fromkeys(("", "0", "opencv", "pinhole", "simple_pinhole", "perspective"), "OPENCV"),
    **dict.fromkeys(("radial", "simple_radial", "plumb_bob", "rational_polynomial"), "OPENCV"),
    **dict.fromkeys(("radtan", "radial-tangential"), "OPENCV"),
    **dict.fromkeys(("1", "true", "fisheye", "opencv_fisheye", "equidistant"), "OPENCV_FISHEYE"),
    **{"fov": "FOV", "none": "none"},
}
_LIST = re.compile(r"d|dist(ortions?)?|(dist(ortion)?_?)?coeff?(icient)?s?", re.IGNORECASE)
_SINGLE = {"OPENCV": ("k1", "k2", "p1", "p2", "k3"), "OPENCV_FISHEYE": ("k1", "k2", "k3", "k4")}
_LENS_KEYS = re.compile(
    r"""[kps]_?\d+ | s | d([_\d].*)? | (xi|alpha|beta)(_.*)? | lens(_?(k|model|param).*)?
    | ((camera|projection)_?)?model
    | .*(dist(?!anc)|coef|skew|radial|tangential|fisheye(?!_crop)|latlong|equirect|ftheta).*
    | orthogr.*""",
    re.IGNORECASE | re.VERBOSE,
)
_OTHER_CAMERA_KEYS = re.compile(
    r"""m\d | (new_?|.*_)?k(new.*|[_\d].*)? | .*mtx.* | .*camera_?mat.*
    | binning_[xy] | [xy]_(offset|fov)
    | (?!std|fps_).*intrinsic(?!_wait).*""",
    re.IGNORECASE | re.VERBOSE,
)


def read(file: CameraFile) -> Calibration | None:
    """The cameras of a file with keys, see `keyed_cameras`; None for a file without."""
    return keyed_cameras(file.data) if isinstance(file.data, Mapping) else None


def read_numbers(file: CameraFile) -> Calibration | None:
    """The camera of a file of only numbers; None for another file."""
    values: Any
    if file.ending == ".npy":
        values = read_array(file.path)
    elif file.has_data:
        if isinstance(file.data, Mapping):
            return None
        values = file.data
    else:
        values = numbers(" ".join(file.lines))
        if values is None:
            return None
    return Calibration(common=numbers_camera(values))


def keyed_cameras(data: Mapping[str, Any]) -> Calibration:
    """The cameras of a mapping, see `keyed_camera`.

    A mapping of one camera also has the part "fisheye", with OpenCV's fisheye model, since four
    coefficients do not determine the model. A mapping with "K1", "K2" or, as in our output,
    "camera1", "camera2" has two cameras, each a matrix or a mapping. Raises as `keyed_camera` does.
    """
    if {*_MATRICES, "fx", *_CAMERAS_OF_A_PAIR}.isdisjoint(data):
        keys = shortened(", ".join(map(str, data)))
        raise InputError(f"no key of a known camera, such as K or fx, among {keys}")
    present = [key for key in _CAMERAS_OF_A_PAIR if data.get(key)]
    if present:
        parts = {}
        warnings = _unread_warning(unread(data, *present))
        for key in present:
            camera = keyed_camera(data[key])
            camera = replace(camera, warnings=(*camera.warnings, *warnings))
            parts[_CAMERAS_OF_A_PAIR[key]] = camera
        return Calibration(parts=parts)
    if {*_MATRICES, "fx"}.isdisjoint(data):  # the cameras of a pair are null
        raise InputError("has no cameras; dgc-pose writes none if a pair has no pose")
    data = dict(data)
    frames = enumerate(data.pop("perFrameIntrinsicCoeffs", ()))  # Record3D: 0.jpg, 1.jpg, ...
    common = keyed_camera(data)
    parts = {}
    by_name = {str(n): replace(common, K=numbers_camera(values).K) for n, values in frames}
    with suppress(InputError):  # not four coefficients
        parts["fisheye"] = keyed_camera({**data, "fisheye_model": 1})
    return Calibration("", by_name, parts, common)


def keyed_camera(data: Any, key: str | None = None) -> Camera:
    """The camera from a matrix, or from a mapping with a matrix or fx, fy, cx, cy, a size and a
    lens. A warning names unread keys that may describe another camera.

    key: of the matrix or the four numbers, by default one of `_MATRICES`. Raises InputError,
    KeyError, TypeError or ValueError if there is no camera, and as `unread` does.
    """
    if not isinstance(data, Mapping):
        return numbers_camera(data)
    key = key or next((key for key in _MATRICES if data.get(key) not in (None, "")), None)
    lens, keys = _lens(data)
    warnings = _unread_warning(unread(data, key, *keys))
    values = [float(data[k]) for k in _FOUR] if key is None else numbers(data[key])
    identity = data.get("identity")
    return Camera(
        numbers_camera(values or (), key or "K").K,
        _size(data),
        lens,
        warnings,
        focal_std=float(data.get("focal_std") or 0),
        centre_std=float(data.get("centre_std_px") or 0),
        lens_std=float(data.get("lens_std") or 0),
        aspect_std=float(data.get("aspect_std") or 0),
        identity=None if identity is None else str(identity),
    )


def _unread_warning(others: Sequence[str]) -> tuple[str, ...]:
    if not others:
        return ()
    return (f"keys that may change K are not read: {shortened(', '.join(others))}",)


def _size(data: Mapping[str, Any]) -> Size | None:
    for keys in _SIZES:
        if all(map(data.get, keys)):
            sides = [number for key in keys for number in numbers(data[key]) or ()]
            if len(sides) != 2:
                raise InputError(f"{' and '.join(keys)}: no width and height")
            return int(sides[0]), int(sides[1])
    return None


def read_table(file: CameraFile) -> Calibration | None:
    """The cameras of a .csv with the columns name, fx, fy, cx, cy; None for another file.

    Optional columns: width, height, focal_std, centre_std_px, lens_std; camera, equal for images
    taken by one camera; the keys of a lens; and qw, qx, qy, qz, tx, ty, tz of cam_from_world.
    Raises InputError, with the path and line, also if a name has two cameras.
    """
    if file.ending != ".csv" or file.has_data or numbers(file.lines[0]) is not None:
        return None

    path = file.path
    by_name: dict[str, dict[str, str]] = {}
    cameras = {}
    poses = {}
    for number, row in enumerate(csv.DictReader(file.text.splitlines()), start=2):
        try:
            if any(row.pop(None, ())):
                raise InputError("more cells than columns")
            if by_name.setdefault(row["name"], row) != row:
                raise InputError(f"the camera of {row['name']} differs from an earlier line")
            camera = keyed_camera(row)
            cameras[row["name"]] = replace(camera, identity=row.get("camera") or None)
            if row.keys() >= {*_POSE}:
                quaternion, t = np.split(np.array([float(row[key]) for key in _POSE]), [4])
                poses[row["name"]] = np.column_stack([rotation_of_quaternion(quaternion), t])
        except KeyError as error:
            raise InputError(path, f"has no column {error}") from None
        except (InputError, TypeError, ValueError, OverflowError) as error:
            raise InputError(path, f"line {number}: {reason(error)}") from None

    if not cameras:
        raise InputError(path, "has no cameras")
    return Calibration("", cameras, poses=poses)


def camera_keys(data: Mapping[str, Any]) -> dict[str, Any]:
    """The values whose keys may describe a lens or another camera."""
    return {
        key: value
        for key, value in data.items()
        if any(keys.fullmatch(key) for keys in (_LENS_KEYS, _OTHER_CAMERA_KEYS))
    }


def unread(data: Mapping[str, Any], *read: str | None) -> list[str]:
    """The keys that are not in `read`, may describe other cameras and are not all zeros, including
    those in nested mappings.

    Raises InputError if there is such a key that may describe a lens.
    """
    others = []
    for key, value in data.items():
        if key in read:
            continue
        held = numbers(value)
        name = str(key).strip()
        is_of_lens = _LENS_KEYS.fullmatch(name)
        if is_of_lens or _OTHER_CAMERA_KEYS.fullmatch(name):
            nothing = (0, 1) if name.startswith("binning") else (0,)
            if held is None or any(value not in nothing for value in held):
                others.append(name)
                if is_of_lens:
                    raise InputError(
                        f"the key {name} may describe the lens, and dgc-pose does not read it"
                    )
        elif isinstance(value, Mapping):
            others += unread(value)
    return others


def _lens(data: Mapping[str, Any]) -> tuple[Distortion | None, Sequence[str]]:
    """The lens of a camera, and the keys that it was read from.

    The keys are COLMAP's "model" and "coefficients"; or the coefficients, in a list or one by one,
    with a key of the model, by default OpenCV's, whose lens is None if all coefficients are zero.
    Raises InputError for a model that COLMAP lacks, and for a wrong number of coefficients.
    """
    if data.get("model"):
        values = numbers(data.get("coefficients")) or ()
        return Distortion(str(data["model"]), tuple(values)), ("model", "coefficients")
    model = "OPENCV"
    for key in _MODEL_KEYS:
        word = str(data.get(key) or "").strip()
        if (named := _MODELS.get(word.lower())) is None:
            raise InputError(f"the {key} {word!r} has no COLMAP model")
        model = model if named == "OPENCV" else named
    if model == "none":
        return None, _MODEL_KEYS

    keys, coefficients = _listed(data) or _single(data, model)
    read = (*_MODEL_KEYS, *keys)
    if model == "OPENCV":
        return _opencv_lens(coefficients, keys), read
    return Distortion(model, tuple(coefficients)), read


def _listed(data: Mapping[str, Any]) -> tuple[list[str], list[float]] | None:
    """The first key of a list of coefficients that are not all zero, and these."""
    for key, value in data.items():
        coefficients = numbers(value) if _LIST.fullmatch(str(key)) else None
        if coefficients and any(coefficients):
            return [key], coefficients
    return None


def _single(data: Mapping[str, Any], model: str) -> tuple[list[str], list[float]]:
    """The keys of the coefficients one by one, and these, 0 for a key that is not there."""
    keys = []
    coefficients = []
    for key in _SINGLE.get(model, ()):
        held = numbers(data.get(key))
        is_single = held is not None and len(held) < 2
        keys += [key] if is_single else []
        coefficients.append(held[0] if held and is_single else 0.0)
    return keys, coefficients


def _opencv_lens(coefficients: Sequence[float], keys: Sequence[str]) -> Distortion | None:
    """COLMAP's lens for OpenCV's coefficients k1 k2 p1 p2 [k3 [k4 k5 k6 [s1 s2 s3 s4 [tx ty]]]]."""
    if (count := len(coefficients)) not in (4, 5, 8, 12, 14):
        raise InputError(f"{keys[0]} has {count} distortion coefficients, not 4, 5, 8, 12 or 14")
    values = (*coefficients, *[0.0] * (14 - len(coefficients)))
    if any(values[8:]):
        raise InputError(f"{keys[0]} has a thin prism or a tilted sensor, which is not supported")
    if any(values[4:]):
        return Distortion("FULL_OPENCV", values[:8])
    return Distortion("OPENCV", values[:4]) if any(values) else None


def numbers(value: Any) -> list[float] | None:
    """The numbers of a text, a list, or a matrix of cv::FileStorage or ROS, row by row; None if the
    value contains anything else."""
    if isinstance(value, Mapping):
        value = value.get("data", "none")
    if isinstance(value, str):
        value = value.replace(",", " ").split()
    try:
        return [] if value is None else np.array(value, np.float64).ravel().tolist()
    except (TypeError, ValueError, OverflowError):
        return None


def numbers_camera(values: Any, name: str = "K") -> Camera:
    """The camera from fx fy cx cy, or from the nine or sixteen numbers of a matrix.

    Raises InputError, naming `name`.
    """
    array = np.asarray(values, dtype=np.float64).ravel()
    if array.size not in (4, 9, 16):
        raise InputError(f"{name} has {array.size} numbers, not fx fy cx cy and no 3x3 matrix")
    array = array.reshape(4 if array.size == 4 else (-1, round(array.size**0.5)))
    if array.size == 9 and array[2, :2].any() and not array[:2, 2].any():
        array = array.T  # column by column, as Open3D and Record3D write it
    return matrix_camera(array, name)
