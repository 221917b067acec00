"""Keys that may be of a lens are read or refused, in every format."""

import json
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from dgc_pose.cameras.calibration import camera_data, read_calibration
from dgc_pose.cameras.camera import Camera
from dgc_pose.cameras.colmap_camera import Distortion
from dgc_pose.errors import InputError
from dgc_pose.images.decoding import Header

SIZE = (640, 480)
K = [[500.0, 0.0, 320.0], [0.0, 510.0, 240.0], [0.0, 0.0, 1.0]]
FLAT = {"fx": 500, "fy": 510, "cx": 320, "cy": 240}
ROS = {"image_width": 640, "image_height": 480, "distortion_model": "plumb_bob"}
NERF = {"fl_x": 500, "fl_y": 510, "cx": 320.5, "cy": 240.5}
KALIBR = {"camera_model": "pinhole", "intrinsics": [500, 510, 320, 240], "resolution": [640, 480]}
RADTAN = {"distortion_model": "radtan", "distortion_coeffs": [-0.3, 0.1, 0.001, 0.002]}
LENS = Distortion("OPENCV", (-0.3, 0.1, 0.001, 0.002))
ONE_BY_ONE = {"k1": -0.3, "k2": 0.1, "p1": 0.001, "p2": 0.002}

P0 = "500 0 320 0 0 510 240 0 0 0 1 0"
DATA = camera_data(Camera(np.array(K), SIZE))


def _words(value: Any) -> str:
    return " ".join(map(str, value)) if isinstance(value, list) else str(value)


# A file's name, and its content with further keys: a text, or what JSON holds.
FORMATS: dict[str, tuple[str, Callable[[dict[str, Any]], Any]]] = {
    "YAML": ("c.yml", lambda keys: {"camera_matrix": K, **keys}),
    "XML": (
        "c.xml",
        lambda keys: (
            "<opencv_storage><camera_matrix><rows>3</rows><cols>3</cols><data>500 0 320 0 510 240"
            " 0 0 1</data></camera_matrix>"
            + "".join(f"<{name}>{_words(value)}</{name}>" for name, value in keys.items())
            + "</opencv_storage>"
        ),
    ),
    "JSON": ("K.json", lambda keys: {"K": K, **keys}),
    "JSON, fx": ("K.json", lambda keys: {**FLAT, **keys}),
    "JSON, COLMAP's": ("K.json", lambda keys: {"K": K, "model": "FOV", "coefficients": 1, **keys}),
    "JSON of a pair": ("K.json", lambda keys: {"K1": K, "K2": K, **keys}),
    "JSON in a pair": ("K.json", lambda keys: {"K1": {"K": K, **keys}, "K2": K}),
    "JSON, deeper": ("K.json", lambda keys: {"K": K, "calibration": keys}),
    "output": ("K.json", lambda keys: {"camera1": {**DATA, **keys}, "camera2": DATA}),
    "ROS": ("ost.yaml", lambda keys: {**ROS, "camera_matrix": {"data": K}, **keys}),
    "Kalibr": ("chain.yaml", lambda keys: {"cam0": {**KALIBR, **RADTAN, **keys}}),
    "Kalibr, none": ("chain.yaml", lambda keys: {"cam0": {**KALIBR, **keys}}),
    "Kalibr, beside": ("chain.yaml", lambda keys: {"cam0": KALIBR, **keys}),
    "EuRoC": ("sensor.yaml", lambda keys: {**KALIBR, **RADTAN, **keys}),
    "NeRF": ("t.json", lambda keys: {**NERF, **keys, "frames": []}),
    "NeRF, frame": ("t.json", lambda keys: {**NERF, "frames": [{"file_path": "a", **keys}]}),
    "KITTI": (
        "calib.txt",
        lambda keys: "\n".join(
            f"{name}: {_words(value)}" for name, value in {"P0": P0, **keys}.items()
        ),
    ),
    "CSV": (
        "c.csv",
        lambda keys: "\n".join(
            ",".join(map(_words, row))
            for row in zip(*{"name": "a.png", **FLAT, **keys}.items(), strict=True)
        ),
    ),
}


def _write(folder: Path, format: str, **keys: Any) -> str:
    name, content = FORMATS[format]
    data = content(keys)
    (folder / name).write_text(data if isinstance(data, str) else json.dumps(data))
    return str(folder / name)


def _lens(path: str) -> Distortion | None:
    camera = read_calibration(path).camera(Path(), "a.png", Header("PNG", SIZE), "K1")
    assert camera.K.tolist() == K
    return camera.distortion


@pytest.mark.parametrize("format", FORMATS)
def test_a_key_of_a_lens_that_is_not_read_is_refused(tmp_path: Path, format: str) -> None:
    for key in ("k5", "dist_something", "lensDistortion", "xi", "skew", "fisheye_params"):
        for value in (0.1, [0.0, 0.1], "text"):
            with pytest.raises(InputError, match=f" {key} may be of the lens, and is not read$"):
                _lens(_write(tmp_path, format, **{key: value}))


@pytest.mark.parametrize("format", ["YAML", "JSON, deeper", "ROS", "Kalibr", "NeRF, frame", "CSV"])
def test_a_key_of_another_camera_has_a_warning(tmp_path: Path, format: str) -> None:
    path = _write(tmp_path, format, K_right=[[9.0]], new_camera_matrix=7)
    camera = read_calibration(path).camera(Path(), "a.png", Header("PNG", SIZE), "K1")
    assert camera.K.tolist() == K
    assert camera.warnings == ("not read, of another camera: K_right, new_camera_matrix",)


@pytest.mark.parametrize("format", FORMATS)
def test_zeros_and_what_is_no_lens_pass(tmp_path: Path, format: str) -> None:
    harmless = {"k5": 0, "dist_x": [0, 0.0], "xi": "", "avg_reprojection_error": 0.3, "flags": 4}
    harmless |= {"board_distance": 2, "timeshift_cam_imu": 0.1, "per_view_errors": [0.2, 0.1]}
    expected = _lens(_write(tmp_path, format))
    assert _lens(_write(tmp_path, format, **harmless)) == expected


@pytest.mark.parametrize("name", ["dist", "dist_coeff", "distCoeffs", "D", "k1 k2 p1 p2"])
@pytest.mark.parametrize(
    "format", ["YAML", "XML", "JSON", "JSON, fx", "JSON in a pair", "ROS", "CSV", "NeRF", "EuRoC"]
)
def test_a_lens_by_any_of_its_names(tmp_path: Path, format: str, name: str) -> None:
    lens = ONE_BY_ONE if name[0] == "k" else {name: [*LENS.coefficients]}
    if format == "EuRoC":
        lens = {"distortion_coeffs": None, **lens}
    assert _lens(_write(tmp_path, format, **lens)) == LENS


@pytest.mark.parametrize("model", [{"fisheye_model": 1}, {"distortion_model": "equidistant"}])
@pytest.mark.parametrize("format", ["YAML", "JSON, fx", "CSV", "NeRF, frame"])
def test_a_fisheye_by_its_model(tmp_path: Path, format: str, model: dict[str, Any]) -> None:
    lens = {"k1": 0.1, "k2": 0.02, "k3": 0.003, "k4": 0.0004}
    expected = Distortion("OPENCV_FISHEYE", tuple(lens.values()))
    assert _lens(_write(tmp_path, format, **lens, **model)) == expected
    with pytest.raises(InputError, match="p1 may be of the lens"):
        _lens(_write(tmp_path, format, **lens, **model, p1=0.1))
