"""One camera in every form that is read. Models of COLMAP are in test_colmap.py."""

import math
import re
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from cameras.formats.camera_files import (
    FORMS,
    FORMS_BY_FORMAT,
    FOUR,
    NERF,
    SIZE,
    K,
    assert_lens,
    kalibr,
    write_file,
)

from dgc_pose.cameras.calibration import parse_camera, read_calibration
from dgc_pose.cameras.colmap_camera import Distortion
from dgc_pose.cameras.formats.opened import CameraFile
from dgc_pose.cameras.formats.recognise import FORMATS, Format


@pytest.mark.parametrize("form", FORMS)
def test_a_camera_in_each_form(tmp_path: Path, form: str) -> None:
    """An image is named a.png."""
    place, content, lens = FORMS[form]
    name, colon, part = place.partition(":")
    path = write_file(tmp_path / name, content)
    calibration = read_calibration(f"{path}{colon}{part}")
    camera = calibration.stated(Path("images"), "a.png", "K1")
    assert camera is not None
    np.testing.assert_array_equal(camera.K, K)
    assert_lens(camera, lens or 4 * [0.0], is_fisheye="fisheye" in form)
    assert camera.size == (None if "without a size" in form else SIZE)
    assert camera.warnings == ()
    if form.startswith("NeRF"):
        assert (camera.identity is None) == (form == "NeRF, frame")


def test_each_format_has_a_form() -> None:
    assert [*FORMS_BY_FORMAT] == [format.example for format in FORMATS]


@pytest.mark.parametrize("format", FORMATS, ids=[format.example for format in FORMATS])
def test_the_reader_and_the_centre_of_each_format_are_those_of_its_row(
    tmp_path: Path, format: Format
) -> None:
    """No reader above it takes its files. Where `half_pixel` is set, the reader subtracts it."""
    for place, content, _ in FORMS_BY_FORMAT[format.example].values():
        name, colon, part = place.partition(":")
        path = write_file(tmp_path / name, content)
        taken = next(other.read for other in FORMATS if other.read(CameraFile(Path(path))))
        assert taken is format.read
        stated = {float(x) for x in re.findall(r"321\.\d+", str(content))}
        camera = read_calibration(f"{path}{colon}{part}").stated(Path("images"), "a.png", "K1")
        assert stated == {camera.K[0, 2] + (0.5 if format.half_pixel else 0.0)}


@pytest.mark.parametrize("name", ["K.txt", "K.csv", "k.mat"])
def test_numbers_split_by_commas_or_blanks(tmp_path: Path, name: str) -> None:
    path = tmp_path / name
    for values in (FOUR, K.ravel().tolist()):
        words = [*map(str, values)]
        for text in map(str.join, (",", " ", " ,", "0" * 80 + ","), 4 * [words]):
            path.write_text(f"# of the left camera\n{text}\n\n")
            for source in (text, str(path)):
                np.testing.assert_array_equal(parse_camera(source).K, K)
    np.save(tmp_path / "K.npy", K)
    np.testing.assert_array_equal(parse_camera(str(tmp_path / "K.npy")).K, K)


def test_kalibrs_fov_is_colmaps(tmp_path: Path) -> None:
    """As Kalibr's by Devernay and Faugeras."""
    path = write_file(tmp_path / "chain.yaml", kalibr("fov", [0.8]))
    assert parse_camera(f"{path}:cam0").distortion == Distortion("FOV", (0.8,))


@pytest.mark.parametrize(
    ("own", "focals"),
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
    tmp_path: Path, own: dict[str, float], focals: list[float], common: dict[str, float]
) -> None:
    data = {**NERF, **common, "frames": [{"file_path": "a", **own}]}
    path = write_file(tmp_path / "transforms.json", data)
    camera = read_calibration(path).stated(tmp_path, "a.jpg")
    assert camera is not None
    np.testing.assert_allclose(camera.K.diagonal()[:2], focals)


@pytest.mark.parametrize(
    ("own", "model"),
    [
        ({}, "OPENCV_FISHEYE"),
        ({"is_fisheye": False}, "OPENCV"),
        ({"camera_model": "OPENCV"}, "OPENCV"),
    ],
)
def test_the_lens_of_a_frame_whose_model_is_another(
    tmp_path: Path, own: dict[str, Any], model: str
) -> None:
    data = {**NERF, "is_fisheye": True, "k1": 0.1, "frames": [{"file_path": "a", **own}]}
    path = write_file(tmp_path / "transforms.json", data)
    camera = read_calibration(path).stated(tmp_path, "a.jpg")
    assert camera is not None and camera.distortion is not None
    assert camera.distortion.model == model
