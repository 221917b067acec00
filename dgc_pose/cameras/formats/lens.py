"""The lens of a camera by its keys, whose names differ from format to format.

A key that may be of the lens and is not read is refused: without it the pose is wrong, and nothing
shows it.
"""

import re
from collections.abc import Mapping, Sequence
from typing import Any

from dgc_pose.cameras.colmap_camera import Distortion
from dgc_pose.cameras.formats.file_cameras import numbers
from dgc_pose.errors import InputError

_MODEL_KEYS = ("camera_model", "distortion_model", "fisheye_model", "is_fisheye")
_MODELS = {  # of OpenCV and NeRF, of ROS, of Kalibr; 0 and 1 of a flag
    **dict.fromkeys(("", "0", "opencv", "pinhole", "simple_pinhole", "perspective"), "opencv"),
    **dict.fromkeys(("radial", "simple_radial", "plumb_bob", "rational_polynomial"), "opencv"),
    **dict.fromkeys(("radtan", "radial-tangential"), "opencv"),
    **dict.fromkeys(("1", "true", "fisheye", "opencv_fisheye", "equidistant"), "fisheye"),
    **{word: word for word in ("fov", "none")},
}
_LIST = re.compile(r"d|dist(ortion)?|(dist(ortion)?_?)?coeff?(icient)?s?", re.IGNORECASE)
_SINGLE = {"opencv": ("k1", "k2", "p1", "p2", "k3"), "fisheye": ("k1", "k2", "k3", "k4")}
_MAY_MATTER = re.compile(
    r"""[kps]_?\d+ | s | d([_\d].*)? | (xi|alpha|beta)(_.*)? | lens(_?param.*)?
    | .*(dist(?!anc)|coef|skew|radial|tangential|fisheye(?!_crop)).*
    | ((camera|projection|lens)_?)?model | [xy]_fov | latlong | equirect.* | orthogr.* | ftheta.*
    # of another camera
    | m\d | (new_?|.*_)?k(new.*|[_\d].*)? | .*mtx.* | .*camera_?mat.* | (?!std).*intrinsic.*""",
    re.IGNORECASE | re.VERBOSE,
)


def may_matter(key: str) -> bool:
    """Whether a key may be of a lens, or of another camera."""
    return _MAY_MATTER.fullmatch(key.strip()) is not None


def require_read(data: Mapping[str, Any], *read: str | None) -> None:
    """Raise InputError, with the key, if one that may matter is not among those that are `read` and
    holds anything but zeros, here or in a mapping that is not read either."""
    for key, value in data.items():
        if key in read:
            continue
        if not may_matter(str(key)):
            if isinstance(value, Mapping):
                require_read(value)
            continue
        held = numbers(value)
        if held is None or any(held):
            raise InputError(
                f"{key} may be of the lens or of another camera, and is not read: take it out if "
                "it does not matter"
            )


def file_lens(data: Mapping[str, Any], *read: str | None) -> Distortion | None:
    """The lens of a camera's keys: the coefficients in a list or one by one, of the model that the
    keys name, or else OpenCV's. None if they are all zero.

    read: further keys that are read. Raises InputError for a model that COLMAP does not have, for
    another number of coefficients, and as `require_read` does.
    """
    model = _model(data)
    keys, coefficients = _coefficients(data, model)
    require_read(data, *read, *_MODEL_KEYS, *keys)
    if model == "none":
        return None
    if model == "fov":
        return Distortion("FOV", tuple(coefficients))
    if model == "opencv":
        return _opencv_lens(coefficients, keys[0])
    if len(coefficients) != 4:
        raise InputError(f"{keys[0]} has {len(coefficients)} fisheye coefficients, not 4")
    return Distortion("OPENCV_FISHEYE", tuple(coefficients))


def _model(data: Mapping[str, Any]) -> str:
    """The model that a key names, and OpenCV's if none names another."""
    model = "opencv"
    for key in _MODEL_KEYS:
        word = str(data.get(key) or "").strip()
        named = _MODELS.get(word.lower())
        if named is None:
            raise InputError(f"the {key} {word!r} has no COLMAP model")
        if named != "opencv":
            model = named
    return model


def _coefficients(data: Mapping[str, Any], model: str) -> tuple[Sequence[str], list[float]]:
    """The keys that hold the coefficients of a model, and these."""
    if model == "none":
        return (), []
    for key, value in data.items():
        if _LIST.fullmatch(str(key)) and any(held := numbers(value) or []):
            return (key,), held
    singles = {key: numbers(data.get(key)) for key in _SINGLE.get(model, ())}
    read = [key for key, held in singles.items() if held is not None and len(held) < 2]
    return read, [(singles[key] or [0.0])[0] if key in read else 0.0 for key in singles]


def _opencv_lens(coefficients: Sequence[float], key: str) -> Distortion | None:
    """COLMAP's model of OpenCV's coefficients k1 k2 p1 p2 [k3 [k4 k5 k6 [s1 s2 s3 s4 [tx ty]]]]."""
    if (count := len(coefficients)) not in (4, 5, 8, 12, 14):
        raise InputError(f"{key} has {count} distortion coefficients, not 4, 5, 8, 12 or 14")
    values = (*coefficients, *[0.0] * (14 - len(coefficients)))
    if any(values[8:]):
        raise InputError(
            f"{key} has a thin prism or a tilted sensor, which no COLMAP model has: "
            "calibrate without CALIB_THIN_PRISM_MODEL and CALIB_TILTED_MODEL"
        )
    if any(values[4:]):
        return Distortion("FULL_OPENCV", values[:8])
    return Distortion("OPENCV", values[:4]) if any(values) else None
