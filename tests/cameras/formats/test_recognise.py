"""Numbers, tables, JSON, KITTI's calibrations by the readmes of its development kits, and NeRF's
transforms.json by docs.nerf.studio/quickstart/data_conventions.html.
"""

import json
import math
from pathlib import Path

import numpy as np
import pytest

from dgc_pose.cameras.calibration import camera_data, pair_cameras, parse_camera, read_calibration
from dgc_pose.cameras.camera import Camera
from dgc_pose.cameras.colmap_camera import Distortion
from dgc_pose.errors import InputError
from dgc_pose.images.decoding import Header
from dgc_pose.images.image import Image

SIZE = (640, 480)
K = np.array([[500.0, 0, 320.25], [0, 510, 240], [0, 0, 1]])
FOUR = ("500.", "510.", "320.25", "240.")
NINE = ("500.", "0.", "320.25", "0.", "510.", "240.", "0.", "0.", "1.")
ALL = {"fl_x": 500, "fl_y": 510, "cx": 320.5, "cy": 240.5, "w": 640, "h": 480}
BY_COLUMNS = K.T.ravel().tolist()
NERF_K = np.array([[500.0, 0, 320], [0, 510, 240], [0, 0, 1]])


def _read(folder: Path, data: dict[str, object], name: str = "a.jpg") -> Camera:
    path = folder / "transforms.json"
    path.write_text(json.dumps(data))
    return read_calibration(str(path)).camera(folder, name, Header("JPEG", SIZE))


@pytest.mark.parametrize("name", ["K.txt", "K.csv", "k.mat"])
def test_numbers_split_by_commas_or_blanks(tmp_path: Path, name: str) -> None:
    path = tmp_path / name
    for words in (FOUR, NINE):
        for text in map(str.join, (",", " ", " ,", "0" * 80 + ","), 4 * [words]):
            path.write_text(f"# of the left camera\n{text}\n\n")
            for source in (text, str(path)):
                np.testing.assert_array_equal(parse_camera(source).K, K)
    np.save(tmp_path / "K.npy", K)
    np.testing.assert_array_equal(parse_camera(str(tmp_path / "K.npy")).K, K)


def test_a_table(tmp_path: Path) -> None:
    path = tmp_path / "cameras.csv"
    text = (
        "name,fx,fy,cx,cy,width,height,focal_std,camera\n"
        "a.jpg,500,510,320,240,640,480,0.01,1\nb.jpg,500,510,320,240,640,480,,\n"
    )
    path.write_text(f"{text}a.jpg,500,510,320,240,640,480,0.01,1\n")
    first, second = read_calibration(str(path)).by_name.values()
    assert (first.focal_std, second.focal_std) == (0.01, 0)
    assert (first.identity, second.identity) == ("1", None)
    assert first.size == SIZE and first.K.diagonal().tolist() == [500, 510, 1]
    path.write_text(f"{text}a.jpg,600,510,320,240,640,480,0.01,1\n")
    with pytest.raises(
        InputError, match=r"cameras\.csv line 4: the camera of a.jpg differs from an earlier line"
    ):
        read_calibration(str(path))


@pytest.mark.parametrize(
    "data",
    [
        {"K": K.tolist(), "size": SIZE},
        {"K": K.ravel().tolist(), "width": 640, "height": 480},
        {"K": [500, 510, 320.25, 240], "size": SIZE},
        {"fx": 500, "fy": 510, "cx": 320.25, "cy": 240, "width": 640, "height": 480},
        camera_data(Camera(K, SIZE)),
        {"width": 640, "height": 480, "intrinsic_matrix": BY_COLUMNS},  # Open3D
        {"w": 640, "h": 480, "K": BY_COLUMNS, "fps": 60, "dw": 192, "poses": [[0, 0]]},  # Record3D
        {"size": SIZE, "K": [*K[0], 0, *K[1], 0, *K[2], 0, 0, 0, 0, 1]},
    ],
)
def test_a_camera_in_json(tmp_path: Path, data: dict[str, object]) -> None:
    camera = _read(tmp_path, data)
    np.testing.assert_array_equal(camera.K, K)
    assert (camera.size, camera.distortion) == (SIZE, None)


def test_the_cameras_of_a_pair_in_json(tmp_path: Path) -> None:
    lens = Distortion("SIMPLE_RADIAL", (0.1,))
    first = Camera(K, SIZE, focal_std=0.02, centre_std=3.0)
    second = Camera(K * [[2], [2], [1]], (1280, 960), lens)
    path = tmp_path / "pose.json"
    images = [Image(np.zeros((480, 640, 3), np.uint8)), Image(np.zeros((960, 1280, 3), np.uint8))]
    for data in (
        {"K1": first.K.tolist(), "K2": {"K": second.K.tolist()}},
        {"status": "ok", "camera1": camera_data(first), "camera2": camera_data(second)},
    ):
        path.write_text(json.dumps(data))
        camera1, camera2 = pair_cameras(str(path), str(path), *images)
        np.testing.assert_array_equal(camera1.K, first.K)
        np.testing.assert_array_equal(camera2.K, second.K)
    assert (camera1.focal_std, camera1.centre_std, camera2.distortion) == (0.02, 3.0, lens)
    assert parse_camera(f"{path}:K2").K[0, 0] == 1000
    with pytest.raises(InputError, match=r"a\.jpg: choose one of K1, K2, as in .*pose\.json:K2$"):
        read_calibration(str(path)).camera(Path(), "a.jpg", Header("JPEG", SIZE))


def test_kittis_odometry_by_the_images_folder(tmp_path: Path) -> None:
    path = tmp_path / "calib.txt"
    lines = [f"P{i}: {500 + i} 0 320 {-0.5 * i} 0 {500 + i} 240 0 0 0 1 0" for i in range(4)]
    path.write_text("\n".join([*lines, "Tr: 1 0 0"]))
    for image, focal in (
        ("image_2/000001.png", 502),
        ("image_03/data/1.png", 503),
        ("image_0/1.png", 500),
    ):
        camera = read_calibration(str(path)).camera(tmp_path, image, Header("PNG", SIZE))
        assert camera.K[[0, 1, 0, 1], [0, 1, 2, 2]].tolist() == [focal, focal, 320, 240]
        assert camera.warnings == ()
    with pytest.raises(InputError, match=r"no camera for 1\.png: choose one of image_0, image_1, "):
        read_calibration(str(path)).camera(tmp_path, "1.png", Header("PNG", SIZE))
    path.write_text(lines[0] + "\n" + lines[0].replace("P0", "P1"))
    camera = read_calibration(str(path)).camera(tmp_path, "1.png", Header("PNG", SIZE))
    assert camera.warnings == ()


def test_kittis_raw_drives(tmp_path: Path) -> None:
    path = tmp_path / "calib_cam_to_cam.txt"
    path.write_text(
        "calib_time: 09-Jan-2012 13:57:47\ncorner_dist: 9.950000e-02\nS_00: 1.392e+03 5.12e+02\n"
        "K_00: 9.8e+02 0 6.9e+02 0 9.7e+02 2.4e+02 0 0 1\nS_rect_00: 6.400e+02 4.800e+02\n"
        "P_rect_00: 5.0e+02 0 3.2e+02 0 0 5.0e+02 2.4e+02 0 0 0 1 0\n"
    )
    camera = parse_camera(f"{path}:image_0")
    assert (camera.size, camera.K[0, 0]) == (SIZE, 500)


def test_intrinsics_of_all_frames_or_of_each(tmp_path: Path) -> None:
    for frame in ({"file_path": "./images/a.jpg"}, {"file_path": "images/a"}):
        for data in ({"frames": [{**frame, **ALL}]}, {**ALL, "frames": [frame]}):
            camera = _read(tmp_path, data)
            np.testing.assert_array_equal(camera.K, NERF_K)
            assert (camera.identity is None) == (data.keys() == {"frames"})
            assert (camera.size, camera.distortion) == (SIZE, None)


@pytest.mark.parametrize(
    ("of_frame", "focals"),
    [
        ({"camera_angle_x": 2 * math.atan(0.5)}, [640, 640]),
        ({"camera_angle_x": 2 * math.atan(0.5), "camera_angle_y": 2 * math.atan(0.4)}, [640, 600]),
        ({"camera_angle_x": 2 * math.atan(0.5), "fl_y": 600}, [640, 600]),
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


def test_the_lens_of_a_frame_whose_model_is_another(tmp_path: Path) -> None:
    """Lenses by their keys are in test_keyed.py."""
    for of_frame, model in (
        ({}, "OPENCV_FISHEYE"),
        ({"is_fisheye": False}, "OPENCV"),
        ({"camera_model": "OPENCV"}, "OPENCV"),
    ):
        frames = [{"file_path": "a", **of_frame}]
        camera = _read(tmp_path, {**ALL, "is_fisheye": True, "k1": 0.1, "frames": frames})
        assert camera.distortion is not None and camera.distortion.model == model


@pytest.mark.parametrize(
    ("data", "error"),
    [
        ({"K": [1, 2]}, "K has 2 numbers"),
        ({"K": K.tolist(), "model": "OPENCV", "coefficients": [1]}, "OPENCV takes 4 coefficients"),
        ({"K": K.tolist(), "focal_std": math.nan}, "focal_std must be finite and at least 0"),
        ({"intrinsics": [{"fx": 1}]}, "no K and no camera of OpenCV's, .* among intrinsics"),
        (
            {"camera1": None, "camera2": None},
            "has no cameras; dgc-pose writes none if a pair has no pose",
        ),
        ({"frames": [{"file_path": "a.png"}]}, "has neither fl_x nor camera_angle_x with w"),
        ({"fl_x": 500, "frames": []}, "neither cx and cy nor w and h"),
        ({**ALL, "frames": [{}]}, "file_path"),
        (
            {"fl_x": 9, "cx": 4, "cy": 4, "frames": [{"file_path": "a", "camera_angle_x": 1}]},
            "a has neither fl_x nor camera_angle_x with w",
        ),
    ],
)
def test_json_that_has_no_camera(tmp_path: Path, data: object, error: str) -> None:
    path = tmp_path / "K.json"
    path.write_text(json.dumps(data))
    with pytest.raises(InputError, match=f"K.json.*{error}"):
        parse_camera(str(path))


def test_each_frame_of_record3d_has_its_camera(tmp_path: Path) -> None:
    frames = [[500 + number, 510, 320, 240] for number in range(3)]
    data = {"w": 640, "h": 480, "K": BY_COLUMNS, "perFrameIntrinsicCoeffs": frames}
    for name, fx in (("rgbd/0.jpg", 500), ("rgbd/2.jpg", 502), ("rgbd/3.jpg", 500.0)):
        camera = _read(tmp_path, data, name)
        assert (camera.K[0, 0], camera.size) == (fx, SIZE)
    assert _read(tmp_path, data, "a.jpg").K[0, 2] == 320.25
