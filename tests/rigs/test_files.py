"""The files of a rig, read by OpenCV, pycolmap and tomllib, and again by --K; an older calibration
against a new one: which cameras moved."""

import json
from dataclasses import replace
from pathlib import Path
from typing import Any

import cv2
import numpy as np
import pycolmap
import pytest
from scipy.spatial.transform import Rotation

from dgc_pose.cameras.calibration import read_calibration
from dgc_pose.cameras.camera import Camera
from dgc_pose.cameras.colmap_camera import Distortion
from dgc_pose.errors import InputError
from dgc_pose.localization.location import Location
from dgc_pose.rigs.files import compared, write_rig
from dgc_pose.system.texts import toml_data

LENSES = [
    None,
    Distortion("OPENCV", (-0.2, 0.05, 0.001, -0.002)),
    Distortion("FULL_OPENCV", (-0.2, 0.05, 0.001, -0.002, 0.03, 0.0, 0.0, 0.0)),
    Distortion("SIMPLE_RADIAL", (0.1,)),
    Distortion("RADIAL_FISHEYE", (0.02, -0.01)),
    Distortion("FISHEYE", ()),
]
FOV = Distortion("FOV", (0.9,))
AWAY = np.random.default_rng(2).uniform((-1, -1, 3), (1, 1, 5), (20, 3))  # in a camera's frame
TOMLS = ("calibration.toml", "camera_array.toml")


def rig(*lenses: Distortion | None, names: str = "abcdef", seed: int = 0) -> dict[str, Location]:
    """Cameras of these lenses. The first one's frame is that of the world."""
    rng = np.random.default_rng(seed)
    cameras = {}
    for number, (name, lens) in enumerate(zip(names, lenses, strict=False)):
        K = np.array([[500.0 + number, 0, 321], [0, 510.3, 238.1], [0, 0, 1]])
        R = Rotation.random(random_state=rng).as_matrix() if number else np.eye(3)
        centre = number * rng.normal(size=3)
        known = {"covariance": 1e-4 * np.eye(6), "probability": 0.97, "R": R, "centre": centre}
        camera = Camera(K, (640, 480), lens, focal_std=0.01)
        cameras[f"cam {name}"] = Location("located", "", (), camera=camera, **known)
    return cameras


def in_world(cameras: dict[str, Location]) -> dict[str, Location]:
    """The cameras in a frame that is none of theirs."""
    W = Rotation.from_rotvec([0.1, 0.2, 0.3]).as_matrix()
    return {n: replace(c, R=c.R @ W, centre=W.T @ c.centre + (1, 2, 3)) for n, c in cameras.items()}


def turned(cameras: dict[str, Location], *angles: float) -> dict[str, Location]:
    """The cameras with rotations by these angles."""
    turns = [Rotation.from_rotvec(angle * np.array([0.6, 0, -0.8])).as_matrix() for angle in angles]
    return {
        name: replace(camera, R=R) for (name, camera), R in zip(cameras.items(), turns, strict=True)
    }


def opencv_pixels(table: dict[str, Any], points: np.ndarray) -> np.ndarray:
    """OpenCV's pixels (N, 2) of points (N, 3) by the keys that anipose and Pose2Sim read."""
    pose = [np.array(table[key]) for key in ("rotation", "translation")]
    values = *pose, np.array(table["matrix"]), np.array(table["distortions"])
    if table["fisheye"]:
        return cv2.fisheye.projectPoints(points[:, None], *values)[0][:, 0]
    return cv2.projectPoints(points, *values)[0][:, 0]


def pixels(location: Location, points: np.ndarray) -> np.ndarray:
    seen = points @ location.R.T + location.t
    return location.camera.project(seen[:, :2] / seen[:, 2:])


@pytest.mark.parametrize(
    ("cameras", "stereo"),
    [
        (rig(*LENSES), []),
        (in_world(rig(*LENSES)), []),
        (rig(*LENSES[:2]), ["stereo.yml"]),
        (turned(rig(None, None), np.pi, np.pi - 1e-7), ["stereo.yml"]),
        (rig(None, FOV), []),
    ],
    ids=["lenses", "in a world", "two", "half turns", "a lens that OpenCV lacks"],
)
def test_a_rig_is_read_again_from_its_files(
    tmp_path: Path, cameras: dict[str, Location], stereo: list[str]
) -> None:
    """As --K reads them: K, lens and pose. rig.json has no cameras without its TOML."""
    paths = write_rig(tmp_path, cameras, {"unit": "m"})
    assert [path.name for path in paths] == [*TOMLS, "rig_config.json", *stereo, "rig.json"]
    points = np.random.default_rng(1).uniform(-0.4, 0.4, (20, 2))
    for path in paths:
        calibration = read_calibration(str(path))
        if path.name == "stereo.yml":  # which has names and poses of its own
            continue
        assert [*calibration.parts] == [*cameras]
        first = next(iter(cameras.values()))
        for name, location in cameras.items():
            camera, stated = calibration.parts[name], location.camera
            np.testing.assert_allclose(camera.K, stated.K, atol=1e-9)
            np.testing.assert_allclose(camera.project(points), stated.project(points), atol=1e-7)
            pose = location.cam_from_world
            if path.name == "rig_config.json":  # in the frame of the first camera
                to_first = np.vstack([first.cam_from_world, [0, 0, 0, 1]])
                pose = pose @ np.linalg.inv(to_first)
            np.testing.assert_allclose(calibration.poses[name], pose, atol=1e-9)
    (tmp_path / "calibration.toml").unlink()
    with pytest.raises(InputError, match=r"calibration\.toml: No such file or directory$"):
        read_calibration(str(tmp_path / "rig.json"))


@pytest.mark.parametrize("name", TOMLS)
def test_the_tables_are_read_by_opencv(tmp_path: Path, name: str) -> None:
    cameras = rig(*LENSES)
    write_rig(tmp_path, cameras, {"unit": "m"})
    data = toml_data((tmp_path / name).read_text(), tmp_path)
    tables = data.get("cameras", data).values()
    for (key, location), table in zip(cameras.items(), tables, strict=False):
        assert table["name"] == key and table["size"] == [640, 480]
        points = (AWAY - location.t) @ location.R
        ours = pixels(location, points)
        np.testing.assert_allclose(opencv_pixels(table, points), ours, atol=1e-4)


def test_the_stereo_file_is_read_by_opencv(tmp_path: Path) -> None:
    cameras = in_world(rig(*LENSES[:2]))
    assert (tmp_path / "stereo.yml") in write_rig(tmp_path, cameras, {"unit": "m"})
    storage = cv2.FileStorage(str(tmp_path / "stereo.yml"), cv2.FILE_STORAGE_READ)
    read = {key: storage.getNode(key).mat() for key in ("M1", "D1", "M2", "D2", "R", "T", "E", "F")}
    first, second = cameras.values()
    point = np.array([0.3, -0.2, 6.0])
    in_both = [location.R @ point + location.t for location in (first, second)]
    np.testing.assert_allclose(read["R"] @ in_both[0] + read["T"][:, 0], in_both[1], atol=1e-12)
    rays = [x / x[2] for x in in_both]
    assert abs(rays[1] @ read["E"] @ rays[0]) < 1e-9
    assert abs((read["M2"] @ rays[1]) @ read["F"] @ (read["M1"] @ rays[0])) < 1e-9
    calibration = read_calibration(str(tmp_path / "stereo.yml"))
    np.testing.assert_array_equal(calibration.poses["M1"], np.eye(3, 4))
    np.testing.assert_allclose(calibration.poses["M2"], np.hstack([read["R"], read["T"]]))
    assert calibration.parts["M2"].size == (640, 480)
    assert calibration.parts["M2"].distortion == LENSES[1]


def test_the_rig_is_read_by_colmap(tmp_path: Path) -> None:
    cameras = rig(*LENSES)
    write_rig(tmp_path, cameras, {"unit": "m"})
    (theirs,) = pycolmap.read_rig_config(tmp_path / "rig_config.json")
    for row, location in zip(theirs.cameras, cameras.values(), strict=True):
        pose = pycolmap.Rigid3d() if row.ref_sensor else row.cam_from_rig
        points = (AWAY - location.t) @ location.R
        seen = row.camera.img_from_cam(pose * points)
        np.testing.assert_allclose(seen - 0.5, pixels(location, points), atol=1e-6)


def test_a_lens_that_opencv_lacks_has_no_key_that_others_take_for_a_lens(tmp_path: Path) -> None:
    write_rig(tmp_path, rig(None, FOV), {"unit": "m"})
    table = toml_data((tmp_path / TOMLS[0]).read_text(), tmp_path)["cam b"]
    assert (table["model"], table["coefficients"]) == ("FOV", [0.9]) and "distortions" not in table


def test_rig_json_has_what_the_toml_lacks(tmp_path: Path) -> None:
    cameras = rig(None, None, names="12")
    write_rig(tmp_path, cameras, {"unit": "m"})
    data = json.loads((tmp_path / "rig.json").read_text())
    location, facts = cameras["cam 2"], data["cameras"]["cam 2"]
    for key in ("centre", "covariance", "probability", "position_error_90"):
        np.testing.assert_array_equal(facts[key], getattr(location, key))
    assert (data["unit"], facts["focal_std"]) == ("m", 0.01)
    table = toml_data((tmp_path / data["calibration"]).read_text(), tmp_path)["cam 2"]
    assert not facts.keys() & table.keys() - {"focal_std"}
    assert data["files"] == [*TOMLS, "rig_config.json", "stereo.yml", "rig.json"]
    listed = toml_data((tmp_path / "camera_array.toml").read_text(), tmp_path)["cameras"]
    assert {key: table["cam_id"] for key, table in listed.items()} == {"1": 1, "2": 2}


STD = 2e-4  # of each axis of the rotations, radians, and of the centres
Poses = dict[str, tuple[np.ndarray, np.ndarray]]  # R and centre
CAMERA = Camera(np.array([[500.0, 0, 320], [0, 500, 240], [0, 0, 1]]), (640, 480))


def poses(count: int, seed: int = 0) -> Poses:
    rng = np.random.default_rng(seed)
    return {
        f"cam{n}": (Rotation.random(random_state=rng).as_matrix(), rng.normal(size=3))
        for n in range(count)
    }


def located(cameras: Poses, seed: int = 1) -> dict[str, Location]:
    """With errors of the stated covariance."""
    rng = np.random.default_rng(seed)
    found = {}
    for name, (R, centre) in cameras.items():
        R = Rotation.from_rotvec(rng.normal(0, STD, 3)).as_matrix() @ R
        at = {"R": R, "centre": centre + rng.normal(0, STD, 3), "covariance": STD**2 * np.eye(6)}
        found[name] = Location("located", "", (), camera=CAMERA, **at)
    return found


def stated(cameras: Poses, seed: int = 2) -> dict[str, np.ndarray]:
    """cam_from_world in another frame and unit."""
    W = Rotation.random(random_state=seed).as_matrix()
    found = {}
    for name, (R, centre) in cameras.items():
        found[name] = np.column_stack([R @ W.T, -R @ W.T @ (7 * W @ centre + (1, 2, 3))])
    return found


@pytest.mark.parametrize("count", [3, 8])
@pytest.mark.parametrize("seed", range(3))
def test_a_camera_that_was_turned_and_shifted_is_told(count: int, seed: int) -> None:
    before = poses(count, seed)
    after = dict(before)
    R, centre = before["cam1"]
    turn = Rotation.from_rotvec(np.radians([0, 0.4, 0.3])).as_matrix()
    after["cam1"] = turn @ R, centre + (0.03, 0, 0.04)
    changes = compared(stated(before), located(after), {"cam1": CAMERA.with_focal(490)})
    assert [change.name for change in changes] == [*before]
    assert [change.moved for change in changes] == [name == "cam1" for name in before]
    change = changes[1]
    assert abs(change.angle_deg - 0.5) < 0.1 and abs(change.distance - 0.05) < 0.005
    assert change.angle_error_deg == pytest.approx(np.degrees(STD) * np.sqrt(6.251), rel=1e-3)
    assert change.focal_change == pytest.approx(100 * (500 / 490 - 1))
    assert changes[0].focal_change is None and change.relative_to is None


def test_cameras_that_stayed_did_not_move() -> None:
    """Also by exact poses, and with a covariance that is not known."""
    false = 0
    for seed in range(30):
        before = poses(4, seed)
        false += sum(change.moved for change in compared(stated(before), located(before, seed), {}))
    assert false <= 1
    exact = {n: Location("located", "", (), R=R, centre=c) for n, (R, c) in poses(4).items()}
    changes = compared(stated(poses(4)), exact, {})
    assert not any(change.moved for change in changes)
    assert {(change.angle_error_deg, change.focal_change) for change in changes} == {(0, None)}


def test_the_second_of_two_cameras_is_relative_to_the_first() -> None:
    before = poses(2)
    (unmoved,) = compared(stated(before), located(before), {})
    assert (unmoved.name, unmoved.relative_to, unmoved.moved) == ("cam1", "cam0", False)
    assert unmoved.angle_error_deg == pytest.approx(np.degrees(STD) * np.sqrt(2 * 6.251), rel=1e-3)
    R, centre = before["cam0"]
    turn = Rotation.from_rotvec(np.radians([0, 1, 0])).as_matrix()
    (moved,) = compared(stated(before), located({**before, "cam0": (turn @ R, centre)}), {})
    assert moved.moved and abs(moved.angle_deg - 1) < 0.1


@pytest.mark.parametrize("count", [2, 3, 5])
@pytest.mark.parametrize("seed", range(3))
def test_two_cameras_that_changed_places_are_told(count: int, seed: int) -> None:
    """Their focal lengths are compared with those of the other place. A third camera that moved
    counts as moved."""
    before = poses(count, seed)
    after = before | {"cam0": before["cam1"], "cam1": before["cam0"]}
    if count == 5:
        R, centre = before["cam3"]
        after["cam3"] = R, centre + (0.3, 0, 0)
    changes = compared(stated(before), located(after), {"cam0": CAMERA.with_focal(490)})
    swapped = {"cam0": "cam1", "cam1": "cam0"}
    names = [*before][count == 2 :]
    assert [change.name for change in changes] == names
    assert [change.place_of for change in changes] == [swapped.get(name) for name in names]
    moved = {*swapped, "cam3"} if count == 5 else {*swapped}
    assert [change.moved for change in changes] == [name in moved for name in names]
    second = changes[names.index("cam1")]
    assert second.angle_deg < 0.1 and second.distance < 0.01
    assert second.focal_change == pytest.approx(100 * (500 / 490 - 1))
    text = second.text("m")
    assert text.startswith("cam1 is where cam0 was, to 0.0")
    assert text.endswith("focal length +2.04 %: the two, or their pictures, changed places")


def test_two_cameras_are_needed() -> None:
    with pytest.raises(InputError, match="^start has 1 of the 3 cameras, and two are needed$"):
        compared(stated(poses(1)), located(poses(3)), {})
