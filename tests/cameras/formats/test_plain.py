"""Numbers, tables and JSON."""

import json
import math
from pathlib import Path

import numpy as np
import pytest

from dgc_pose.cameras.calibration import camera_data, pair_cameras, parse_camera, read_calibration
from dgc_pose.cameras.camera import Camera
from dgc_pose.cameras.colmap_camera import Distortion
from dgc_pose.errors import InputError
from dgc_pose.images.header import Header
from dgc_pose.images.image import Image

SIZE = (640, 480)
K = np.array([[500.0, 0, 320.25], [0, 510, 240], [0, 0, 1]])
FOUR = ("500.", "510.", "320.25", "240.")
NINE = ("500.", "0.", "320.25", "0.", "510.", "240.", "0.", "0.", "1.")


@pytest.mark.parametrize("words", [FOUR, NINE], ids=["four", "nine"])
@pytest.mark.parametrize("between", [",", " ", "\t", " ,"])
def test_numbers_split_by_commas_or_blanks(
    tmp_path: Path, words: tuple[str, ...], between: str
) -> None:
    path = tmp_path / "K.txt"
    path.write_text(f"# of the left camera\n{between.join(words)}\n\n")
    for text in (between.join(words), str(path), between.join(word + "0" * 80 for word in words)):
        np.testing.assert_array_equal(parse_camera(text).K, K)


@pytest.mark.parametrize("name", ["K.npy", "K.csv", "K", "k.mat"])
def test_a_matrix_in_a_file(tmp_path: Path, name: str) -> None:
    path = tmp_path / name
    np.save(path, K) if name.endswith("npy") else np.savetxt(path, K, delimiter=",")
    np.testing.assert_array_equal(parse_camera(str(path)).K, K)


def test_a_table(tmp_path: Path) -> None:
    path = tmp_path / "cameras.csv"
    path.write_text(
        "name,fx,fy,cx,cy,width,height,focal_std,camera\n"
        "a.jpg,500,510,320,240,640,480,0.01,1\nb.jpg,500,510,320,240,640,480,,\n"
    )
    cameras = [
        read_calibration(str(path)).camera(Path("photos"), name, Header("JPEG", SIZE))
        for name in ("a.jpg", "b.jpg")
    ]
    assert [camera.focal_std for camera in cameras] == [0.01, 0]
    assert [camera.identity for camera in cameras] == ["1", None]
    assert cameras[0].size == SIZE and cameras[0].K[1, 1] == 510


def test_a_name_twice_in_a_table(tmp_path: Path) -> None:
    path = tmp_path / "cameras.csv"
    text = "name,fx,fy,cx,cy\na,500,510,320,240\nb,500,510,320,240\na,500,510,320,240\n"
    path.write_text(text)
    assert read_calibration(str(path)).by_name["a"].K[0, 0] == 500
    path.write_text(text + "a,600,610,320,240\n")
    with pytest.raises(InputError, match=r"cameras\.csv:5: another camera of a than in a line"):
        read_calibration(str(path))


@pytest.mark.parametrize(
    "data",
    [
        {"K": K.tolist(), "size": SIZE},
        {"K": K.ravel().tolist(), "width": 640, "height": 480},
        {"K": [500, 510, 320.25, 240], "size": SIZE},
        {"fx": 500, "fy": 510, "cx": 320.25, "cy": 240, "width": 640, "height": 480},
        camera_data(Camera(K, SIZE)),
    ],
)
def test_a_camera_in_json(tmp_path: Path, data: dict[str, object]) -> None:
    path = tmp_path / "K.json"
    path.write_text(json.dumps(data))
    camera = parse_camera(str(path))
    np.testing.assert_array_equal(camera.K, K)
    assert (camera.size, camera.distortion) == (SIZE, None)


@pytest.mark.parametrize("keys", [("K1", "K2"), ("camera1", "camera2")])
def test_the_cameras_of_a_pair_in_json(tmp_path: Path, keys: tuple[str, str]) -> None:
    lens = Distortion("SIMPLE_RADIAL", (0.1,))
    first = Camera(K, SIZE, focal_std=0.02, centre_std=3.0)
    second = Camera(K * [[2], [2], [1]], (1280, 960), lens)
    if keys[0] == "K1":
        values: list[object] = [first.K.tolist(), {"K": second.K.tolist()}]
    else:
        values = [camera_data(first), camera_data(second)]
    path = tmp_path / "pose.json"
    path.write_text(json.dumps({"status": "ok", **dict(zip(keys, values, strict=True))}))
    images = [Image(np.zeros((480, 640, 3), np.uint8)), Image(np.zeros((960, 1280, 3), np.uint8))]
    camera1, camera2 = pair_cameras(str(path), str(path), *images)
    np.testing.assert_array_equal(camera1.K, first.K)
    np.testing.assert_array_equal(camera2.K, second.K)
    if keys[0] == "camera1":
        assert (camera1.focal_std, camera1.centre_std, camera2.distortion) == (0.02, 3.0, lens)
    assert parse_camera(f"{path}:K2").K[0, 0] == 1000
    with pytest.raises(
        InputError, match=r"has no camera for a\.jpg: another of its cameras is .*pose\.json:K2$"
    ):
        read_calibration(str(path)).camera(Path(), "a.jpg", Header("JPEG", SIZE))


@pytest.mark.parametrize(
    ("data", "error"),
    [
        ({"K": [1, 2]}, "K has 2 numbers"),
        ({"K": K.tolist(), "model": "OPENCV", "coefficients": [1]}, "OPENCV takes 4 coefficients"),
        ({"K": K.tolist(), "focal_std": -0.1}, "focal_std must be finite and at least 0"),
        ({"K": K.tolist(), "focal_std": math.nan}, "focal_std must be finite and at least 0"),
        ({"K": K.tolist(), "centre_std_px": math.inf}, "centre_std must be finite and at least 0"),
        ({"camera1": None, "camera2": None}, "not a file of cameras that can be read"),
        ({"fx": "a", "fy": 1, "cx": 1, "cy": 1}, "could not convert"),
    ],
)
def test_json_that_has_no_camera(tmp_path: Path, data: dict[str, object], error: str) -> None:
    path = tmp_path / "K.json"
    path.write_text(json.dumps(data))
    with pytest.raises(InputError, match=f"K.json.*{error}"):
        parse_camera(str(path))
