"""Files that name the cameras of a rig: OpenCV's stereo file and EasyMocap's pair as
cv2.FileStorage writes them, TOML as anipose, caliscope and Pose2Sim do; lenses against OpenCV's.
Poses of the files that `rig` writes are in tests/rigs/test_files.py."""

import json
from pathlib import Path
from typing import Any

import cv2
import numpy as np
import pytest
from cameras.formats.opencv_files import assert_lens, write_storage

from dgc_pose.cameras.calibration import image_camera, pair_cameras, parse_camera, read_calibration
from dgc_pose.cameras.camera import Camera
from dgc_pose.errors import InputError
from dgc_pose.images.decoding import Header
from dgc_pose.images.image import Image

SIZE = (640, 480)
LENS = np.array([-0.21, 0.06, 0.002, -0.001, 0.013, 0.02, 0.01, 0.004])
NAMES = [("M1", "D1", "M2", "D2"), ("K1", "D1", "K2", "D2")]
NAMES += [("cameraMatrix1", "distCoeffs1", "cameraMatrix2", "distCoeffs2")]


R = cv2.Rodrigues(np.array([0.1, 0.2, 0.3]))[0]


def _K(number: int) -> np.ndarray:
    return np.array([[500.0 + number, 0, 321], [0, 510, 238], [0, 0, 1]])


def _assert_camera(camera: Camera, number: int, lens: np.ndarray, is_fisheye: bool = False) -> None:
    np.testing.assert_array_equal(camera.K, _K(number))
    assert_lens(camera, lens, is_fisheye)


def _tables(path: Path, tables: dict[str, dict[str, Any]]) -> str:
    """Write a TOML, whose simple values are those of JSON."""
    lines = []
    for name, table in tables.items():
        lines += [f"[{name}]", *(f"{key} = {json.dumps(value)}" for key, value in table.items())]
    text = "\n".join(["CreationDate = 2023-05-06T11:12:27.631355", *lines, ""])
    path.write_text(text.replace("NaN", "nan").replace("Infinity", "inf"))
    return str(path)


def _table(number: int, lens: np.ndarray = LENS[:5], **others: Any) -> dict[str, Any]:
    pose = {"rotation": [0.1, 0.2, 0.3], "translation": [1.0, 2.0, 3.0]}
    intrinsics = {"matrix": _K(number).tolist(), "distortions": lens.tolist()}
    return {"size": SIZE, **intrinsics, **pose, "error": 0.3, **others}


def _image(name: str = "a.png") -> Image:
    return Image(np.zeros((480, 640, 3), np.uint8), name)


@pytest.mark.parametrize("names", NAMES)
def test_a_stereo_file(tmp_path: Path, names: tuple[str, ...]) -> None:
    """With what OpenCV's sample and its users write beside: the pose and the rectification."""
    poses: dict[str, np.ndarray] = {key: np.eye(3) for key in ("E", "F", "R1", "R2", "Q")}
    poses |= {"R": R, "T": np.array([[1.0], [2], [3]]), "P1": np.eye(3, 4), "P2": np.eye(3, 4)}
    for lenses in ((LENS[:4], LENS[:5]), (LENS, np.zeros(5))):
        values = dict(zip(names, (_K(1), lenses[0][None], _K(2), lenses[1][:, None]), strict=True))
        path = write_storage(tmp_path / "stereo.yml", image_width=640, **values, **poses)
        cameras = pair_cameras(path, path, _image(), _image())
        for number, camera, lens in zip((1, 2), cameras, lenses, strict=True):
            _assert_camera(camera, number, lens)
            assert camera.identity == f"{path} {names[2 * number - 2]}"
            said = f"{names[0]} is used for image 1, {names[2]} for image 2"
            assert [said in warning for warning in camera.warnings] == [True] * (names[0] != "K1")
        _assert_camera(parse_camera(f"{path}:{names[2]}"), 2, lenses[1])


def test_a_plain_stereo_file_of_a_fisheye_with_its_size(tmp_path: Path) -> None:
    path = tmp_path / "stereo.yaml"
    values = {f"K{n}": _K(n).tolist() for n in (1, 2)} | {"D1": LENS[:4].tolist(), "D2": [0.0] * 4}
    path.write_text(json.dumps({**values, "fisheye_model": 1, "imageSize": SIZE}))
    camera = parse_camera(f"{path}:K1")
    _assert_camera(camera, 1, LENS[:4], is_fisheye=True)
    assert camera.size == SIZE


def test_easymocaps_pair_of_files(tmp_path: Path) -> None:
    """Cameras by the names of the images; extri.yml has no cameras."""
    values: dict[str, Any] = {"names": ["01", "02", "left_3"]}
    for number, name in enumerate(values["names"]):
        values |= {f"K_{name}": _K(number), f"dist_{name}": LENS[None, :5] * number}
    values |= {"H_02": 480, "W_02": 640}
    path = write_storage(tmp_path / "intri.yml", **values)
    write_storage(tmp_path / "extri.yml", names=values["names"], R_01=np.ones((3, 1)))
    calibration = read_calibration(path)
    for number, name in enumerate(values["names"]):
        camera = calibration.camera(tmp_path, f"views/{name}.jpg", Header("JPEG", SIZE))
        _assert_camera(camera, number, LENS[:5] * number)
        assert camera.size == SIZE and camera.warnings == ()
    with pytest.raises(InputError, match=r"a\.jpg: choose one of 01, 02, left_3, as in .*:left_3$"):
        calibration.camera(tmp_path, "a.jpg", Header("JPEG", SIZE))
    with pytest.raises(InputError, match=r"extri\.yml: no K and no camera"):
        read_calibration(str(tmp_path / "extri.yml"))


@pytest.mark.parametrize(
    ("form", "called"),
    [
        ("cam_{}", [["cam_0", "A"], ["cam_1", "B"], ["cam_2", "C"]]),  # anipose
        ("cameras.{}", [["0", "cam_0"], ["1", "cam_1"], ["2", "cam_2"]]),  # caliscope
    ],
)
def test_the_tables_of_a_toml(tmp_path: Path, form: str, called: list[list[str]]) -> None:
    """By the key or the name, of --K or of the image; fisheye as Pose2Sim has it."""
    lenses = [LENS[:5], LENS[:4], LENS]
    tables = {}
    for number, lens in enumerate(lenses):
        table = _table(number, lens, fisheye=number == 1)
        tables[form.format(number)] = table | (
            {"name": called[number][1]} if "cam_" in form else {}
        )
    others = {"metadata": {"adjusted": False}, "charuco": {"board_height": 11.0}}
    path = _tables(tmp_path / "rig.toml", {**tables, **others})
    for number, lens in enumerate(lenses):
        for name in called[number]:
            for camera in (
                parse_camera(f"{path}:{name}"),
                image_camera(path, _image(f"views/{name}.png"), "--K"),
            ):
                _assert_camera(camera, number, lens, is_fisheye=number == 1)
                assert (camera.size, camera.warnings) == (SIZE, ())
                assert camera.identity == f"{path} {called[number][1]}"
    listed = ", ".join(names[1] for names in called)
    with pytest.raises(InputError, match=f"has {listed}, and no cam_9$"):
        parse_camera(f"{path}:cam_9")
    with pytest.raises(InputError, match=rf"for a\.png: choose one of {listed}, as in {path}:"):
        pair_cameras(path, path, _image(), _image())


def test_two_cameras_are_those_of_a_pair_in_their_order_and_one_is_of_all_images(
    tmp_path: Path,
) -> None:
    tables = {"left": _table(1), "right": _table(2)}
    path = _tables(tmp_path / "rig.toml", tables)
    first, second = pair_cameras(path, path, _image(), _image("b.png"))
    assert (first.K[0, 0], second.K[0, 0]) == (501, 502)
    (warning,) = {*first.warnings, *second.warnings}
    assert warning == (
        f"{path} has two cameras and no image names: left is used for image 1, right for image 2"
    )
    named = pair_cameras(path, path, _image("right.png"), _image("left.jpg"))
    assert [camera.K[0, 0] for camera in named] == [502, 501]
    assert [camera.warnings for camera in named] == [(), ()]
    with pytest.raises(InputError, match="no camera for a.png: choose one of left, right"):
        image_camera(path, _image())  # of no pair
    path = _tables(tmp_path / "one.toml", {"left": tables["left"]})
    assert image_camera(path, _image()).K[0, 0] == 501


@pytest.mark.parametrize("matrix", [None, "null", [[float("nan")] * 3] * 3])
def test_cameras_that_are_not_calibrated(tmp_path: Path, matrix: Any) -> None:
    """None is of any image, nor the other one by the order."""
    empty = {"size": SIZE, "rotation_count": 0} | ({} if matrix is None else {"matrix": matrix})
    path = tmp_path / "rig.toml"
    _tables(path, {"cameras.0": _table(0), "cameras.1": empty})
    assert parse_camera(f"{path}:cam_0").K[0, 0] == 500
    with pytest.raises(InputError, match="has cam_0, and no matrix of cam_1$"):
        parse_camera(f"{path}:cam_1")
    with pytest.raises(InputError, match="no camera for b.png: choose one of cam_0, as in"):
        pair_cameras(str(path), str(path), _image(), _image("b.png"))
    _tables(path, {"cameras.0": {**empty, "distortions": "null"}})
    with pytest.raises(InputError, match=r"rig\.toml: no matrix of cam_0$"):
        read_calibration(str(path))


@pytest.mark.parametrize(
    ("changes", "error"),
    [
        ({"matrix": [1.0, 2.0]}, "left: matrix has 2 numbers"),
        ({"distortions": [0.1] * 3}, "left: distortions has 3 distortion coefficients"),
        ({"distortions": "text"}, "left: the key distortions may describe the lens, and dgc-pose"),
        ({"fisheye": "omni"}, "left: the fisheye 'omni' has no COLMAP model"),
        ({"size": [640]}, "left: size: no width and height"),
        ({"size": [float("inf"), 480]}, "left: .*infinity"),
        ({"rotation": [0.1, 0.2]}, "left: rotation and translation are not a rigid pose"),
        ({"rotation": (2 * R).tolist()}, "left: rotation and translation are not a rigid pose"),
        ({"rotation": (-R).tolist()}, "left: rotation and translation are not a rigid pose"),
        ({"rotation": [0.1, float("inf"), 0.3]}, "left: rotation and translation are no"),
        ({"translation": [1.0, 2.0]}, "left: rotation and translation are not a rigid pose"),
        ({"name": "right"}, "two cameras have the name right"),
    ],
)
def test_a_table_that_is_no_camera(tmp_path: Path, changes: dict[str, Any], error: str) -> None:
    path = tmp_path / "rig.toml"
    _tables(path, {"left": _table(1, **changes), "right": _table(2)})
    with pytest.raises(InputError, match=f"^K: {path}: {error}"):
        read_calibration(str(path))


def test_a_stereo_file_of_other_keys(tmp_path: Path) -> None:
    """Half of one is of no image unless it is named, and the lens of a third is refused."""
    path = write_storage(tmp_path / "stereo.yml", M1=_K(1), D1=LENS)
    assert parse_camera(f"{path}:M1").K[0, 0] == 501
    with pytest.raises(InputError, match="no camera for a.png: choose one of M1, as in"):
        pair_cameras(path, path, _image(), _image())
    path = write_storage(tmp_path / "a.yml", M1=_K(1), M2=_K(2), D3=LENS)
    with pytest.raises(
        InputError,
        match=r"a\.yml: M1: the key D3 may describe the lens, and dgc-pose does not read it$",
    ):
        read_calibration(path)


def test_the_poses_of_a_toml(tmp_path: Path) -> None:
    """By a rotation vector or a matrix. A camera without a pose, as caliscope writes them, has a K
    and no pose."""
    tables = {"left": _table(1), "right": _table(2, rotation=R.tolist())}
    tables |= {"a": _table(3, rotation="null", translation="null"), "b": _table(4, translation=[])}
    calibration = read_calibration(_tables(tmp_path / "rig.toml", tables))
    assert [*calibration.poses] == ["left", "right"]
    for pose in calibration.poses.values():
        np.testing.assert_allclose(pose, np.column_stack([R, [1, 2, 3]]), atol=1e-12)


def test_a_name_counts_more_than_the_key_of_another_table(tmp_path: Path) -> None:
    tables = {"cameras.0": _table(0, name="1"), "cameras.1": _table(1, name="2")}
    path = _tables(tmp_path / "rig.toml", tables)
    assert [parse_camera(f"{path}:{name}").K[0, 0] for name in "012"] == [500, 500, 501]


def test_colmaps_rig_config(tmp_path: Path) -> None:
    """With and without camera_params; several rigs have no common frame."""
    pose = {"cam_from_rig_rotation": [0.0, 0.0, 2.0, 0.0], "cam_from_rig_translation": [1, 2, 3]}
    of_lens = {"camera_model_name": "OPENCV", "camera_params": [500, 510, 321.5, 238.5, *LENS[:4]]}
    cameras = [
        {"image_prefix": "rig/left/", "ref_sensor": True, **of_lens},
        {"image_prefix": "rig/right/", **pose, **of_lens},
        {"image_prefix": "rig/third/", **pose},
    ]
    path = tmp_path / "rig_config.json"
    path.write_text(json.dumps([{"cameras": cameras}]))
    calibration = read_calibration(str(path))
    assert calibration.rig == ("left", "right", "third")
    _assert_camera(calibration.parts["right"], 0, LENS[:4])
    turn = [[-1, 0, 0, 1], [0, 1, 0, 2], [0, 0, -1, 3]]  # of a quaternion of another length
    np.testing.assert_allclose(calibration.poses["right"], turn, atol=1e-15)
    path.write_text(json.dumps([{"cameras": cameras[:1]}, {"cameras": cameras[1:]}]))
    calibration = read_calibration(str(path))
    assert [*calibration.parts] == ["left", "right"] and not calibration.poses
    for change, error in (
        ({"camera_params": [1, 2]}, "OPENCV takes 8 parameters"),
        ({"camera_model_name": "none"}, "'none' is not a COLMAP model"),
        (
            {"cam_from_rig_rotation": [0, 0, 0, 0]},
            "right: rotation and translation are not a rigid",
        ),
        ({"cam_from_rig_translation": [1, 2]}, "right: rotation and"),
        ({"image_prefix": "rig2/left"}, "two cameras have the name left"),
    ):
        path.write_text(json.dumps([{"cameras": [cameras[0], {**cameras[1], **change}]}]))
        with pytest.raises(InputError, match=f"^K: {path}: {error}"):
            read_calibration(str(path))
