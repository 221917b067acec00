"""NeRF's transforms.json, as nerfstudio's and instant-ngp's documents describe it.

docs.nerf.studio/quickstart/data_conventions.html: camera_model, fl_x, fl_y, cx, cy, w, h, k1 to k4,
p1, p2, for all frames or in each. The values are COLMAP's, as their converters copy them.
"""

import json
import math
from pathlib import Path

import cv2
import numpy as np
import pytest

from dgc_pose.cameras.calibration import parse_camera, read_calibration
from dgc_pose.cameras.camera import Camera
from dgc_pose.errors import InputError
from dgc_pose.images.header import Header

SIZE = (640, 480)
ALL = {"fl_x": 500, "fl_y": 510, "cx": 320.5, "cy": 240.5, "w": 640, "h": 480}
K = np.array([[500.0, 0, 320], [0, 510, 240], [0, 0, 1]])


def _read(folder: Path, data: dict[str, object], name: str = "a.jpg") -> Camera:
    path = folder / "transforms.json"
    path.write_text(json.dumps(data))
    return read_calibration(str(path)).camera(folder, name, Header("JPEG", SIZE))


@pytest.mark.parametrize("frame", [{"file_path": "./images/a.jpg"}, {"file_path": "images/a"}])
@pytest.mark.parametrize("each", [False, True])
def test_intrinsics_of_all_frames_or_of_each(
    tmp_path: Path, frame: dict[str, object], each: bool
) -> None:
    data = {"frames": [{**frame, **ALL}]} if each else {**ALL, "frames": [frame]}
    camera = _read(tmp_path, data)
    np.testing.assert_array_equal(camera.K, K)
    assert (camera.size, camera.distortion) == (SIZE, None)


def test_the_fields_of_view_alone(tmp_path: Path) -> None:
    angles = {"camera_angle_x": 2 * math.atan(0.5), "camera_angle_y": 2 * math.atan(0.4)}
    camera = _read(tmp_path, {**angles, "w": 640, "h": 480, "frames": [{"file_path": "a"}]})
    np.testing.assert_allclose(camera.K, [[640, 0, 319.5], [0, 600, 239.5], [0, 0, 1]])


@pytest.mark.parametrize(
    ("of_frame", "focals"),
    [
        ({"camera_angle_x": 2 * math.atan(0.5)}, [640, 640]),
        ({"camera_angle_x": 2 * math.atan(0.5), "fl_y": 600}, [640, 600]),
        ({"fl_x": 700}, [700, 700]),
        ({"fl_x": 700, "fl_y": 710}, [700, 710]),
        ({"cx": 320.5}, [500, 510]),
    ],
)
@pytest.mark.parametrize("common", [{}, {"camera_angle_x": 1.0, "camera_angle_y": 0.8}])
def test_focal_lengths_of_a_frame(
    tmp_path: Path, of_frame: dict[str, float], focals: list[float], common: dict[str, float]
) -> None:
    frames = [{"file_path": "a", **of_frame}]
    camera = _read(tmp_path, {**ALL, **common, "frames": frames})
    np.testing.assert_allclose(camera.K.diagonal()[:2], focals)


def test_a_frame_names_its_model(tmp_path: Path) -> None:
    data = {**ALL, "is_fisheye": True, "k1": 0.1}
    for of_frame, model in (
        ({}, "OPENCV_FISHEYE"),
        ({"is_fisheye": False}, "OPENCV"),
        ({"camera_model": "OPENCV"}, "OPENCV"),
    ):
        lens = _read(tmp_path, {**data, "frames": [{"file_path": "a", **of_frame}]}).distortion
        assert lens is not None and lens.model == model


def test_a_lens_of_opencv(tmp_path: Path) -> None:
    """Lenses by each of their keys are in test_lens.py."""
    lens = {"k1": -0.2, "k2": 0.05, "p1": 0.002, "p2": -0.001, "k3": 0.01}
    camera = _read(tmp_path, {**ALL, **lens, "k4": 0, "frames": [{"file_path": "a.jpg"}]})
    pixels = np.random.default_rng(0).uniform((60, 40), (580, 440), (30, 2))
    rays = np.column_stack([camera.normalise(pixels), np.ones(30)])
    again, _ = cv2.projectPoints(rays, np.zeros(3), np.zeros(3), K, np.array([*lens.values()]))
    np.testing.assert_allclose(again[:, 0], pixels, atol=1e-3)


def test_frames_of_common_intrinsics_have_one_identity(tmp_path: Path) -> None:
    frames = [{"file_path": "a.jpg"}, {"file_path": "b.jpg"}, {"file_path": "c.jpg", "fl_x": 700}]
    identities = {name: _read(tmp_path, {**ALL, "frames": frames}, name).identity for name in "abc"}
    assert identities["a"] == identities["b"] is not None


@pytest.mark.parametrize(
    ("data", "error"),
    [
        ({"frames": [{"file_path": "a.png"}]}, "no fl_x, and no camera_angle_x with w"),
        ({"fl_x": 500, "frames": []}, "neither cx and cy nor w and h"),
        ({**ALL, "frames": [{}]}, "file_path"),
        (
            {"fl_x": 9, "cx": 4, "cy": 4, "frames": [{"file_path": "a", "camera_angle_x": 1}]},
            "a has no fl_x, and no camera_angle_x with w",
        ),
        ({**ALL, "frames": 3}, "not a file of cameras that can be read"),
    ],
)
def test_what_cannot_be_read_is_named(tmp_path: Path, data: dict[str, object], error: str) -> None:
    path = tmp_path / "transforms.json"
    path.write_text(json.dumps(data))
    with pytest.raises(InputError, match=f"transforms.json.*{error}"):
        parse_camera(str(path))
