"""COLMAP's lines and files, against those that pycolmap writes and reads."""

import sqlite3
from contextlib import closing
from pathlib import Path

import numpy as np
import pycolmap
import pytest

from dgc_pose.cameras.by_image import Calibration
from dgc_pose.cameras.calibration import parse_camera, read_calibration
from dgc_pose.cameras.camera import Camera
from dgc_pose.cameras.colmap_camera import intrinsics, parameters
from dgc_pose.cameras.formats.colmap import read_database
from dgc_pose.errors import InputError

SIZE = (640, 480)
COEFFICIENTS = {
    "PINHOLE": [],
    "SIMPLE_PINHOLE": [],
    "SIMPLE_RADIAL": [-0.12],
    "RADIAL": [-0.15, 0.03],
    "OPENCV": [-0.2, 0.05, 0.002, -0.001],
    "FULL_OPENCV": [-0.2, 0.05, 0.002, -0.001, 0.01, 0.02, 0.01, 0.0],
    "SIMPLE_RADIAL_FISHEYE": [0.02],
    "RADIAL_FISHEYE": [0.03, -0.005],
    "OPENCV_FISHEYE": [-0.03, 0.005, -0.001, 0.0002],
    "THIN_PRISM_FISHEYE": [0.01, -0.01, 0.001, 0.002, 0.001, 0, 0.001, 0.002],
    "RAD_TAN_THIN_PRISM_FISHEYE": [
        *(0.2, -0.4, 0.3, -0.2, 0.05, -0.005, 0.001, 0.002, 0.001, 0, -0.001, 0)
    ],
    "SIMPLE_FISHEYE": [],
    "FISHEYE": [],
    "FOV": [0.8],
    "SIMPLE_DIVISION": [-0.15],
    "DIVISION": [-0.15],
    "EUCM": [0.6, 1.1],
}
MODELS = set(pycolmap.CameraModelId.__members__) - {"INVALID", "EQUIRECTANGULAR"}


def _theirs(model: str) -> pycolmap.Camera:
    """A camera of a model whose lens bends the image."""
    camera = pycolmap.Camera.create_from_model_name(1, model, 500.0, *SIZE)
    parameters = np.array(camera.params)
    parameters[camera.principal_point_idxs()] = (321.5, 238.25)
    parameters[camera.extra_params_idxs()] = COEFFICIENTS[model]
    if len(camera.focal_length_idxs()) == 2:
        parameters[camera.focal_length_idxs()] = (500, 510)
    camera.params = parameters.tolist()
    return camera


def _line(camera: pycolmap.Camera) -> str:
    return ",".join([camera.model.name, *map(str, SIZE), *map(repr, camera.params.tolist())])


@pytest.mark.parametrize("model", sorted(MODELS))
def test_every_model_is_pycolmaps_in_every_form_and_in_its_own_parameters(
    tmp_path: Path, model: str
) -> None:
    """Pixels to rays, where COLMAP's pixels are half a pixel more, and back. Resized to another
    aspect ratio, K has two focal lengths, also of a model that has one."""
    theirs = _theirs(model)
    reconstruction = pycolmap.Reconstruction()
    reconstruction.add_camera_with_trivial_rig(theirs)
    reconstruction.write_text(tmp_path)
    reconstruction.write_binary(tmp_path)
    for path in tmp_path.glob("images.*"):
        path.unlink()
    pixels = np.random.default_rng(1).uniform((150, 100), (500, 400), (20, 2))
    expected = theirs.cam_from_img(pixels + 0.5)
    for source in (_line(theirs), tmp_path / "cameras.txt", tmp_path / "cameras.bin"):
        camera = parse_camera(str(source))
        np.testing.assert_allclose(camera.normalise(pixels), expected, atol=1e-8)
        np.testing.assert_allclose(camera.project(expected), pixels, atol=1e-5)
        assert camera.size == SIZE
    for size in (SIZE, (320, 480)):
        resized = camera.resized(size)
        K, lens = intrinsics(*parameters(resized.K, resized.distortion))
        again = Camera(K, size, lens)
        np.testing.assert_array_equal(again.K, resized.K)
        own = pixels * np.divide(size, SIZE)
        np.testing.assert_allclose(again.normalise(own), resized.normalise(own), atol=1e-9)
    with pytest.raises(InputError, match="skew of 3"):
        parameters(np.array([[500.0, 3, 320], [0, 500, 240], [0, 0, 1]]), camera.distortion)


LEFT_RIGHT = ("left/1.png", "right/2.png")


@pytest.mark.parametrize(
    ("listed", "root", "name", "taken"),
    [
        (LEFT_RIGHT, "/F", "left/1.png", 0),
        (LEFT_RIGHT, "/F/right", "2.png", 1),
        (LEFT_RIGHT, "/copy", "1.png", 0),  # the only one of its file name
        (LEFT_RIGHT, "", "3.png", None),
        (("images/1", "./images/2"), "", "/F/images/2.png", 1),
        (("../../images/a/1.png", "../../images/b/1.png"), "/F/images", "b/1.png", 1),
        (("d/2.jpg", "e/2.jpg"), "/F", "e/2.jpg", 1),
        (("2.jpg", "e/2.jpg"), "/F", "2.jpg", 0),
    ],
)
def test_an_image_has_the_camera_of_its_path_or_else_of_its_file_name(
    listed: tuple[str, ...], root: str, name: str, taken: int | None
) -> None:
    cameras = {image: Camera(np.eye(3)) for image in listed}
    calibration = Calibration("sparse", cameras)
    camera = calibration.named(Path(root), name)
    assert camera is (None if taken is None else cameras[listed[taken]])
    if listed == ("d/2.jpg", "e/2.jpg"):
        with pytest.raises(InputError, match="^2.jpg matches both d/2.jpg and e/2.jpg of sparse"):
            calibration.named(Path(), "2.jpg")


def test_a_database(tmp_path: Path) -> None:
    """Cameras with a known focal length, and pairs with matches."""
    with pycolmap.Database.open(tmp_path / "a.db") as database:
        for number, known in ((1, True), (2, False)):
            camera = _theirs("OPENCV")
            camera.camera_id = number
            camera.has_prior_focal_length = known
            database.write_camera(camera, use_camera_id=True)
        for number, name in ((1, "b.png"), (2, "d/a.png"), (3, "c.png")):
            image = pycolmap.Image(name=name, camera_id=1 + number % 2, image_id=number)
            database.write_image(image, use_image_id=True)
        for pair, count in (((1, 2), 2), ((2, 3), 1), ((1, 3), 0)):
            database.write_matches(*pair, np.zeros((count, 2), np.uint32))
    content = (tmp_path / "a.db").read_bytes()
    pair_list = read_database(tmp_path / "a.db")
    assert pair_list.names == ("b.png", "c.png", "d/a.png")
    assert pair_list.pairs == (("b.png", "d/a.png"), ("d/a.png", "c.png"))
    (name,) = pair_list.cameras
    assert name == "d/a.png" and pair_list.cameras[name].size == SIZE
    expected = parse_camera(_line(_theirs("OPENCV")))
    assert pair_list.cameras[name].distortion == expected.distortion
    np.testing.assert_array_equal(pair_list.cameras[name].K, expected.K)
    assert (tmp_path / "a.db").read_bytes() == content
    for column in ("model = 99", "params = zeroblob(64)", "width = 'text'"):
        (tmp_path / "b.db").write_bytes(content)
        with closing(sqlite3.connect(tmp_path / "b.db")) as damaged:
            damaged.execute(f"UPDATE cameras SET {column}")
            damaged.commit()
        with pytest.raises(InputError, match=r"b\.db cannot be read as a COLMAP database"):
            read_database(tmp_path / "b.db")


def test_a_database_whose_log_is_not_in_the_file_yet(tmp_path: Path) -> None:
    """As COLMAP leaves it while it writes, and where it was killed."""
    with pycolmap.Database.open(tmp_path / "a.db") as database:
        database.write_camera(_theirs("PINHOLE"))
    with closing(sqlite3.connect(tmp_path / "a.db")) as writer:
        writer.execute("PRAGMA journal_mode = WAL")
        writer.execute("PRAGMA wal_autocheckpoint = 0")
        for name in ("a.png", "b.png"):
            writer.execute("INSERT INTO images(name, camera_id) VALUES (?, 1)", (name,))
        writer.execute("INSERT INTO matches VALUES (?, 1, 2, NULL)", (2**31 - 1 + 2,))
        writer.commit()
        content = [(tmp_path / name).read_bytes() for name in ("a.db", "a.db-wal")]
        assert read_database(tmp_path / "a.db").pairs == (("a.png", "b.png"),)
        (tmp_path / "link.db").symlink_to("a.db")
        assert read_database(tmp_path / "link.db").pairs == (("a.png", "b.png"),)
    for name, data in zip(("killed.db", "killed.db-wal"), content, strict=True):
        (tmp_path / name).write_bytes(data)
    assert read_database(tmp_path / "killed.db").names == ("a.png", "b.png")
    assert (tmp_path / "killed.db").read_bytes() == content[0]
    assert (tmp_path / "killed.db-wal").read_bytes() == content[1]


@pytest.mark.parametrize("quaternion", ["0 0 0 0", "1 nan 0 0"])
def test_a_pose_that_is_not_rigid_is_refused(tmp_path: Path, quaternion: str) -> None:
    """And the name of a model may be in small letters."""
    (tmp_path / "cameras.txt").write_text("1 pinhole 640 480 500 510 320 240\n")
    images = tmp_path / "images.txt"
    images.write_text("1 1 0 0 0 1 2 3 1 a b.png\n1 2 -1\n")
    assert [*read_calibration(str(tmp_path)).poses] == ["a b.png"]
    images.write_text(f"1 {quaternion} 1 2 3 1 a b.png\n\n")
    with pytest.raises(
        InputError, match="a b.png that is not rigid|cannot be read as a COLMAP model"
    ):
        read_calibration(str(tmp_path))
