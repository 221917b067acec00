"""Files of several cameras: which one an image has, and their poses. Each form by itself is in
test_forms.py; poses of the files that `rig` writes are in tests/rigs/test_files.py."""

import re
from pathlib import Path
from typing import Any

import cv2
import numpy as np
import pytest
from cameras.formats.camera_files import ROWS, SIZE, Storage, kalibr, table, write_file

from dgc_pose.cameras.calibration import (
    camera_data,
    image_camera,
    pair_cameras,
    parse_camera,
    read_calibration,
)
from dgc_pose.cameras.camera import Camera
from dgc_pose.cameras.colmap_camera import Distortion
from dgc_pose.errors import InputError
from dgc_pose.images.decoding import Header
from dgc_pose.images.image import Image

R = cv2.Rodrigues(np.array([0.1, 0.2, 0.3]))[0]


def matrix(focal: float) -> list[list[float]]:
    return [[focal, 0, 320], [0, focal, 240], [0, 0, 1]]


def _image(name: str = "a.png") -> Image:
    return Image(np.zeros((480, 640, 3), np.uint8), name)


EASYMOCAP = Storage(names=["1", "2", "left_3"])
EASYMOCAP |= {"K_1": matrix(500), "K_2": matrix(501), "K_left_3": matrix(502)}
KITTI = "\n".join(f"P{k}: {500 + k} 0 320 {-0.5 * k} 0 510 240 0 0 0 1 0" for k in range(4))
RECORD3D = {
    "K": [500, 0, 0, 0, 510, 0, 320, 240, 1],
    "w": 640,
    "h": 480,
    "perFrameIntrinsicCoeffs": [[500 + number, 510, 320, 240] for number in range(3)],
}


@pytest.mark.parametrize(
    ("file", "content", "focals"),
    [
        ("a.yaml", kalibr("none", []), {"mav0/cam0/data/1": 500, "mav0/cam1/data/1": 400}),
        ("a.txt", KITTI, {"image_2/01": 502, "image_03/data/1": 503, "image_0/1": 500}),
        ("a.yml", EASYMOCAP, {"views/1": 500, "2": 501, "left_3": 502}),
        (
            "anipose.toml",
            {"cam_0": table(0, name="A"), "cam_1": table(1, name="B")},
            {"cam_0": 500, "v/A": 500, "cam_1": 501, "B": 501},
        ),
        (
            "caliscope.toml",
            {"cameras.0": table(0), "cameras.1": table(1)},
            {"0": 500, "v/cam_0": 500, "cam_1": 501},
        ),
        # A name counts more than the key of another table.
        (
            "named.toml",
            {"cameras.0": table(0, name="1"), "cameras.1": table(1, name="2")},
            {"0": 500, "1": 500, "2": 501},
        ),
        ("pair.json", {"K1": matrix(500), "K2": matrix(501)}, {}),
        ("record3d.json", RECORD3D, {"rgbd/0": 500, "rgbd/2": 502, "rgbd/3": 500}),
    ],
)
def test_an_image_has_the_camera_that_its_name_or_its_folder_names(
    tmp_path: Path, file: str, content: Any, focals: dict[str, float]
) -> None:
    """Before a list of pairs does. Other images have none, unless it is named beside the file."""
    path = write_file(tmp_path / file, content)
    header = Header("PNG", SIZE)
    calibration = read_calibration(path)
    for image, focal in focals.items():
        camera = calibration.camera(tmp_path, f"{image}.png", header)
        assert (camera.K[0, 0], camera.size, camera.warnings) == (focal, SIZE, ())
        assert not calibration.lacks(tmp_path, f"{image}.png")
        if image in calibration.parts:
            named = parse_camera(f"{path}:{image}")
            assert (named.K[0, 0], named.identity) == (focal, f"{path} {image}")
    if calibration.common is None:
        assert calibration.lacks(tmp_path, "cam9/x.png")
        *_, last = calibration.parts
        names = ", ".join(calibration.parts)
        lacking = f"no camera for cam9/x.png: choose one of {names}, as in {path}:{last}"
        with pytest.raises(InputError, match=f"{re.escape(lacking)}$"):
            calibration.camera(tmp_path, "cam9/x.png", header)
        with pytest.raises(InputError, match=f"has {names}, and no cam9$"):
            parse_camera(f"{path}:cam9")


@pytest.mark.parametrize(
    ("file", "content", "names"),
    [
        ("a.toml", {"left": table(1), "right": table(2)}, ("left", "right")),
        ("a.yml", Storage(M1=matrix(501), M2=matrix(502)), ("M1", "M2")),
        (
            "a.yml",
            Storage(cameraMatrix1=matrix(501), cameraMatrix2=matrix(502)),
            ("cameraMatrix1", "cameraMatrix2"),
        ),
        ("a.yml", Storage(K1=matrix(501), K2=matrix(502)), ()),  # named as those of a pair
    ],
)
def test_two_cameras_are_those_of_a_pair_in_their_order(
    tmp_path: Path, file: str, content: Any, names: tuple[str, ...]
) -> None:
    """Unless the names of the images are theirs."""
    path = write_file(tmp_path / file, content)
    cameras = pair_cameras(path, path, _image(), _image("b.png"))
    assert [camera.K[0, 0] for camera in cameras] == [501, 502]
    warnings = {text for camera in cameras for text in camera.warnings}
    said = "{} has two cameras and no image names: {} is used for image 1, {} for image 2"
    assert warnings == ({said.format(path, *names)} if names else set())
    with pytest.raises(InputError, match="no camera for a.png: choose one of "):
        image_camera(path, _image())  # of no pair
    if "left" in names:
        named = pair_cameras(path, path, _image("right.png"), _image("left.jpg"))
        assert [camera.K[0, 0] for camera in named] == [502, 501]
        assert [camera.warnings for camera in named] == [(), ()]


def test_one_camera_is_that_of_all_images_but_half_of_a_stereo_file_of_none(tmp_path: Path) -> None:
    path = write_file(tmp_path / "one.toml", {"left": table(1)})
    assert image_camera(path, _image()).K[0, 0] == 501
    row = "500 0 320 0 0 510 240 0 0 0 1 0"
    path = write_file(tmp_path / "calib.txt", f"P0: {row}\nP1: {row}\nTr: 1 0 0")
    camera = image_camera(path, _image())
    assert camera.K[0, 0] == 500 and camera.warnings == ()
    path = write_file(tmp_path / "half.yml", Storage(M1=matrix(501)))
    assert parse_camera(f"{path}:M1").K[0, 0] == 501
    with pytest.raises(InputError, match="no camera for a.png: choose one of M1, as in"):
        pair_cameras(path, path, _image(), _image())


def test_the_cameras_of_a_pair_in_json_have_their_deviations_and_lenses(tmp_path: Path) -> None:
    first = Camera(np.array(ROWS), SIZE, focal_std=0.02, centre_std=3.0)
    second = Camera(np.array(ROWS), SIZE, Distortion("SIMPLE_RADIAL", (0.1,)))
    data = {"status": "ok", "camera1": camera_data(first), "camera2": camera_data(second)}
    path = write_file(tmp_path / "pose.json", data)
    camera1, camera2 = pair_cameras(path, path, _image(), _image())
    assert (camera1.focal_std, camera1.centre_std, camera1.distortion) == (0.02, 3.0, None)
    assert (camera2.focal_std, camera2.distortion) == (0.0, second.distortion)


def test_a_table_has_identities_and_a_name_one_camera(tmp_path: Path) -> None:
    text = (
        "name,fx,fy,cx,cy,width,height,focal_std,camera\n"
        "a.jpg,500,510,320,240,640,480,0.01,1\nb.jpg,500,510,320,240,640,480,,\n"
    )
    path = write_file(tmp_path / "a.csv", f"{text}a.jpg,500,510,320,240,640,480,0.01,1\n")
    first, second = read_calibration(path).by_name.values()
    assert (first.focal_std, second.focal_std) == (0.01, 0)
    assert (first.identity, second.identity) == ("1", None)


@pytest.mark.parametrize("empty", [None, "null", [[float("nan")] * 3] * 3])
def test_cameras_that_are_not_calibrated(tmp_path: Path, empty: Any) -> None:
    """None is of any image, nor the other one by the order."""
    without = {"size": SIZE, "rotation_count": 0} | ({} if empty is None else {"matrix": empty})
    path = write_file(tmp_path / "a.toml", {"cameras.0": table(0), "cameras.1": without})
    assert parse_camera(f"{path}:cam_0").K[0, 0] == 500
    with pytest.raises(InputError, match="has cam_0, and no matrix of cam_1$"):
        parse_camera(f"{path}:cam_1")
    with pytest.raises(InputError, match="no camera for b.png: choose one of cam_0, as in"):
        pair_cameras(path, path, _image(), _image("b.png"))
    write_file(tmp_path / "a.toml", {"cameras.0": {**without, "distortions": "null"}})
    with pytest.raises(InputError, match=r"a\.toml: no matrix of cam_0$"):
        read_calibration(path)


def test_the_poses_of_a_toml(tmp_path: Path) -> None:
    """By a rotation vector or a matrix. A camera without a pose, as caliscope writes them, has a K
    and no pose."""
    tables = {"left": table(1), "right": table(2, rotation=R.tolist())}
    tables |= {"a": table(3, rotation="null", translation="null"), "b": table(4, translation=[])}
    calibration = read_calibration(write_file(tmp_path / "rig.toml", tables))
    assert [*calibration.poses] == ["left", "right"] and len(calibration.parts) == 4
    for pose in calibration.poses.values():
        np.testing.assert_allclose(pose, np.column_stack([R, [1, 2, 3]]), atol=1e-12)


def test_the_poses_of_colmaps_rig_config(tmp_path: Path) -> None:
    """With and without camera_params; several rigs have no common frame."""
    pose = {"cam_from_rig_rotation": [0.0, 0.0, 2.0, 0.0], "cam_from_rig_translation": [1, 2, 3]}
    lens = {"camera_model_name": "PINHOLE", "camera_params": [500, 510, 321.5, 238.5]}
    cameras = [
        {"image_prefix": "rig/left/", "ref_sensor": True, **lens},
        {"image_prefix": "rig/right/", **pose, **lens},
        {"image_prefix": "rig/third/", **pose},
    ]
    path = write_file(tmp_path / "rig_config.json", [{"cameras": cameras}])
    calibration = read_calibration(path)
    assert calibration.rig == ("left", "right", "third")
    turn = [[-1, 0, 0, 1], [0, 1, 0, 2], [0, 0, -1, 3]]  # of a quaternion of another length
    np.testing.assert_allclose(calibration.poses["right"], turn, atol=1e-15)
    rigs = [{"cameras": cameras[:1]}, {"cameras": cameras[1:]}]
    calibration = read_calibration(write_file(Path(path), rigs))
    assert [*calibration.parts] == ["left", "right"] and not calibration.poses
