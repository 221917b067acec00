"""Keys of a lens and of other cameras, in every format that has keys."""

from collections.abc import Callable
from pathlib import Path
from typing import Any

import pytest
from cameras.formats.camera_files import SIZE, write_file

from dgc_pose.cameras.calibration import parse_camera, read_calibration
from dgc_pose.cameras.camera import Camera
from dgc_pose.cameras.colmap_camera import Distortion
from dgc_pose.errors import InputError
from dgc_pose.images.decoding import Header

MATRIX = [[500.0, 0.0, 320.0], [0.0, 510.0, 240.0], [0.0, 0.0, 1.0]]
FLAT = {"fx": 500, "fy": 510, "cx": 320, "cy": 240}
ROS_KEYS = {"image_width": 640, "image_height": 480, "distortion_model": "plumb_bob"}
NERF = {"fl_x": 500, "fl_y": 510, "cx": 320.5, "cy": 240.5}
KALIBR_KEYS = {"camera_model": "pinhole", "intrinsics": [500, 510, 320, 240], "resolution": SIZE}
RADTAN = {"distortion_model": "radtan", "distortion_coeffs": [-0.3, 0.1, 0.001, 0.002]}
RADTAN_LENS = Distortion("OPENCV", (-0.3, 0.1, 0.001, 0.002))
ONE_BY_ONE = {"k1": -0.3, "k2": 0.1, "p1": 0.001, "p2": 0.002}

P0 = "500 0 320 0 0 510 240 0 0 0 1 0"


def _words(value: Any) -> str:
    return " ".join(map(str, value)) if isinstance(value, list) else str(value)


# A file's name, and its content with further keys: a text, or what JSON holds.
FORMATS: dict[str, tuple[str, Callable[[dict[str, Any]], Any]]] = {
    "YAML": ("c.yml", lambda keys: {"camera_matrix": MATRIX, **keys}),
    "JSON": ("K.json", lambda keys: {"K": MATRIX, **keys}),
    "JSON of a pair": ("K.json", lambda keys: {"K1": MATRIX, "K2": MATRIX, **keys}),
    "JSON in a pair": ("K.json", lambda keys: {"K1": {"K": MATRIX, **keys}, "K2": MATRIX}),
    "JSON, deeper": ("K.json", lambda keys: {"K": MATRIX, "calibration": keys}),
    "ROS": ("ost.yaml", lambda keys: {**ROS_KEYS, "camera_matrix": {"data": MATRIX}, **keys}),
    "Kalibr": ("chain.yaml", lambda keys: {"cam0": {**KALIBR_KEYS, **RADTAN, **keys}}),
    "Kalibr, beside": ("chain.yaml", lambda keys: {"cam0": KALIBR_KEYS, **keys}),
    "EuRoC": ("sensor.yaml", lambda keys: {**KALIBR_KEYS, **RADTAN, **keys}),
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


def _camera(folder: Path, format: str, **keys: Any) -> Camera:
    name, content = FORMATS[format]
    calibration = read_calibration(write_file(folder / name, content(keys)))
    camera = calibration.camera(Path("cam0/image_0"), "a.png", Header("PNG", SIZE), "K1")
    assert camera.K.tolist() == MATRIX
    return camera


@pytest.mark.parametrize("format", FORMATS)
def test_a_key_that_is_not_read(tmp_path: Path, format: str) -> None:
    """It is refused if it may describe the lens, and a warning if it may change K; zeros and other
    keys pass."""
    for key in ("k5", "dist_x", "lensDistortion", "xi", "skew", "fisheye_params", "orthographic"):
        for value in (0.1, [0.0, 0.1], "text"):
            with pytest.raises(
                InputError, match=f" {key} may describe the lens, and dgc-pose does not read it$"
            ):
                _camera(tmp_path, format, **{key: value})
    others = {"K_right": 7, "new_camera_matrix": 7, "new_K": 3, "x_fov": 60, "binning_x": 2}
    camera = _camera(tmp_path, format, **others)
    assert camera.warnings == (f"keys that may change K are not read: {', '.join(others)}",)
    harmless = {"k5": 0, "dist_x": [0, 0.0], "xi": "", "avg_reprojection_error": 0.3, "flags": 4}
    harmless |= {"board_distance": 2, "timeshift_cam_imu": 0.1, "per_view_errors": [0.2, 0.1]}
    camera = _camera(tmp_path, format, **harmless, binning_x=1, binning_y=0)
    assert camera.distortion == _camera(tmp_path, format).distortion
    assert camera.warnings == ()


@pytest.mark.parametrize("name", ["dist", "dist_coeff", "distCoeffs", "D", "k1 k2 p1 p2"])
@pytest.mark.parametrize("format", ["YAML", "JSON in a pair", "ROS", "CSV", "NeRF", "EuRoC"])
def test_a_lens_by_any_of_its_names(tmp_path: Path, format: str, name: str) -> None:
    lens = ONE_BY_ONE if name[0] == "k" else {name: [*RADTAN_LENS.coefficients]}
    if format == "EuRoC":
        lens = {"distortion_coeffs": None, **lens}
    assert _camera(tmp_path, format, **lens).distortion == RADTAN_LENS


@pytest.mark.parametrize("model", [{"fisheye_model": 1}, {"distortion_model": "equidistant"}])
@pytest.mark.parametrize("format", ["YAML", "CSV", "NeRF, frame"])
def test_a_fisheye_by_its_model(tmp_path: Path, format: str, model: dict[str, Any]) -> None:
    lens = {"k1": 0.1, "k2": 0.02, "k3": 0.003, "k4": 0.0004}
    expected = Distortion("OPENCV_FISHEYE", tuple(lens.values()))
    assert _camera(tmp_path, format, **lens, **model).distortion == expected
    with pytest.raises(InputError, match="p1 may describe the lens"):
        _camera(tmp_path, format, **lens, **model, p1=0.1)


@pytest.mark.parametrize(
    "others",
    [
        {"K": MATRIX, "width": 640, "height": 480, "resolution": 5},
        {**NERF, "w": 640, "h": 480, "width": 1280, "height": 960, "image_size": 3},
        {**NERF, "w": 640, "h": 480, "mask": {"k1": 3}},
    ],
)
def test_what_else_a_file_holds_is_no_size_and_no_lens(
    tmp_path: Path, others: dict[str, Any]
) -> None:
    camera = parse_camera(write_file(tmp_path / "a.json", others))
    assert (camera.size, camera.distortion, camera.warnings) == (SIZE, None, ())
