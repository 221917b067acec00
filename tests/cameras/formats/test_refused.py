"""Files without a camera, or with one that COLMAP has not, in each format: one line with the file
and the reason."""

import math
import re
from pathlib import Path
from typing import Any

import cv2
import numpy as np
import pytest
from cameras.formats.camera_files import LENS, ROWS, Storage, kalibr, table, write_file

from dgc_pose.cameras.calibration import read_calibration
from dgc_pose.errors import InputError

INF = float("inf")
R = cv2.Rodrigues(np.array([0.1, 0.2, 0.3]))[0]
NERF = {"fl_x": 500, "cx": 320, "cy": 240}
ROS = {"image_width": 640, "image_height": 480, "camera_matrix": {"data": ROWS}}
NOT_RIGID = "left: rotation and translation are not a rigid pose"


def rig(**changes: Any) -> dict[str, Any]:
    """The tables of a TOML, one of them changed."""
    return {"left": table(1, **changes), "right": table(2)}


def rig_config(**changes: Any) -> list[Any]:
    """COLMAP's rig of two cameras, the second one changed."""
    lens = {
        "camera_model_name": "OPENCV",
        "camera_params": [500, 510, 321.5, 238.5, *LENS[:4]],
    }
    second = {
        "image_prefix": "rig/right/",
        "cam_from_rig_rotation": [0.0, 0.0, 2.0, 0.0],
        "cam_from_rig_translation": [1, 2, 3],
    }
    first = {"image_prefix": "rig/left/", "ref_sensor": True}
    return [{"cameras": [first | lens, second | lens | changes]}]


@pytest.mark.parametrize(
    ("name", "content", "error"),
    [
        ("K.txt", "1 2 3\n4 5 6\n", "K has 6 numbers, not fx fy cx cy and no 3x3 matrix"),
        ("K.txt", "one two three", r"other file of cameras \(it begins with 'one two three'\)"),
        (
            "ros.txt",
            "distortion_model: plumb_bob\n",
            "it begins with 'distortion_model: plumb_bob'",
        ),
        ("K.txt", bytes(range(256)), "is not UTF-8 text; expected a file of cameras"),
        ("K.NPY", "1 0 0\n0 1 0\n0 0 1\n", "cannot be read as an .npy"),
        ("cameras.txt", "# none\n1 PINHOLE 9\n", "has a line that is not a camera: "),
        (
            "cameras.txt",
            "1 PINHOLE 640 480 500 510 320 240 -1",
            "has a line that is not a camera: PINHOLE takes 4 parameters",
        ),
        ("cameras.bin", "xx", "cannot be read as COLMAP's cameras"),
        ("c.csv", "name,fx\na,1\n", "has no column 'fy'"),
        ("c.csv", "name,fx,fy,cx,cy\na,1,-1,1,1\n", "line 2: K must be upper triangular"),
        ("c.csv", "name,fx,fy,cx,cy\na,5,5,3,2,-0.3", "line 2: more cells than columns"),
        (
            "c.csv",
            "name,fx,fy,cx,cy\na,5,5,3,2\na,6,5,3,2\n",
            "line 3: the camera of a differs from an earlier line",
        ),
        ("rig.toml", "[cam_0]\nsize 640\n", "cannot be read as TOML"),
        ("rig.toml", ".".join(["a"] * 9999) + " = 1", "a key of over 100 parts"),
        ("rig.toml", "a = " + "[" * 9999, "cannot be read as TOML"),
        ("rig.toml", "a = 1", "no key of a known camera, such as K or fx, among a$"),
        ("c.yaml", "a: &x [1]\nb: [*x, *x]\n", r"cannot be read as YAML \(it contains an alias"),
        ("c.yaml", {**ROS, "distortion_model": "thin_prism"}, "'thin_prism' has no COLMAP"),
        ("c.yaml", {**ROS, "distortion_coefficients": [0.1] * 12}, "a thin prism"),
        (
            "c.yaml",
            "distortion_model: ''\nheight: 480\nK: [0, 0, 0, 0, 0, 0, 0, 0, 0]\n",
            "K must be upper",
        ),
        ("c.yaml", kalibr("radtan", [1]), "1 distortion coefficients"),
        ("c.yaml", kalibr("none", []).replace("pinhole", "ds"), "'ds' has no COLMAP"),
        ("c.yaml", kalibr("poly", [1]), "cam0: the distortion_model 'poly'"),
        (
            "c.yaml",
            kalibr("none", []).replace("[]\n  T_cn", "[0.1]\n  T_cn"),
            "cam1: the key distortion_coeffs may describe the lens",
        ),
        ("extri.yml", Storage(names=["1"], R_1=np.ones((3, 1))), "no key of a known camera"),
        (
            "stereo.yml",
            Storage(M1=ROWS, M2=ROWS, D3=LENS),
            "M1: the key D3 may describe the lens, and dgc-pose does not read it$",
        ),
        ("t.json", "{", "cannot be read as a file of cameras"),
        ("K.json", {"K": [1, 2]}, "K has 2 numbers"),
        ("K.json", {"K": ROWS, "model": "OPENCV", "coefficients": [1]}, "OPENCV takes 4 coeff"),
        ("K.json", {"K": ROWS, "focal_std": math.nan}, "focal_std must be finite and at least 0"),
        ("K.json", {"intrinsics": [{"fx": 1}]}, "no key of a known .* among intri"),
        (
            "K.json",
            {"camera1": None, "camera2": None},
            "has no cameras; dgc-pose writes none if a pair has no pose",
        ),
        (
            "t.json",
            {"frames": [{"file_path": "a.png"}]},
            "has neither fl_x nor camera_angle_x with w",
        ),
        ("t.json", {"fl_x": 500, "frames": []}, "neither cx and cy nor w and h"),
        ("t.json", {**NERF, "frames": [{}]}, "file_path"),
        (
            "t.json",
            {**NERF, "frames": [{"file_path": "a", "camera_angle_x": 1}]},
            "a has neither fl_x nor camera_angle_x with w",
        ),
        ("rig.toml", rig(matrix=[1.0, 2.0]), "left: matrix has 2 numbers"),
        ("rig.toml", rig(lens=[0.1] * 3), "left: distortions has 3 distortion coefficients"),
        ("rig.toml", rig(lens="text"), "left: the key distortions may describe the lens, and dgc-"),
        ("rig.toml", rig(fisheye="omni"), "left: the fisheye 'omni' has no COLMAP model"),
        ("rig.toml", rig(size=[640]), "left: size: no width and height"),
        ("rig.toml", rig(size=[INF, 480]), "left: .*infinity"),
        ("rig.toml", rig(rotation=[0.1, 0.2]), NOT_RIGID),
        ("rig.toml", rig(rotation=(2 * R).tolist()), NOT_RIGID),
        ("rig.toml", rig(rotation=(-R).tolist()), NOT_RIGID),
        ("rig.toml", rig(rotation=[0.1, INF, 0.3]), NOT_RIGID),
        ("rig.toml", rig(translation=[1.0, 2.0]), NOT_RIGID),
        ("rig.toml", rig(name="right"), "two cameras have the name right"),
        ("rig.json", rig_config(camera_params=[1, 2]), "OPENCV takes 8 parameters"),
        ("rig.json", rig_config(camera_model_name="none"), "'none' is not a COLMAP model"),
        ("rig.json", rig_config(cam_from_rig_rotation=[0] * 4), "right: rotation and translation"),
        ("rig.json", rig_config(cam_from_rig_translation=[1, 2]), "right: rotation and"),
        ("rig.json", rig_config(image_prefix="rig2/left"), "two cameras have the name left"),
    ],
)
def test_a_file_without_a_camera_is_refused_with_what_it_is(
    tmp_path: Path, name: str, content: Any, error: str
) -> None:
    path = tmp_path / name
    if isinstance(content, bytes):
        path.write_bytes(content)
    else:
        write_file(path, content)
    with pytest.raises(InputError) as caught:
        read_calibration(str(path), "K1")
    said = str(caught.value)
    assert said.startswith(f"K1: {path}") and re.search(error, said) and "\n" not in said
