"""Models in the formats of other tools, read back by other readers than wrote them."""

import json
from pathlib import Path

import cv2
import numpy as np
import PIL.Image
import pycolmap
import pytest
from command_line import assert_refused, contents, run
from scipy.spatial.transform import Rotation
from worlds import IMAGE, WorldScene, world_scene, write_colmap

from dgc_pose.model import load_model

SCENE = world_scene(count=20)
LENSES = {
    "PINHOLE": (900, 905, 510, 390),
    "OPENCV": (900, 905, 510, 390, -0.15, 0.02, 0.003, -0.002),
    "OPENCV_FISHEYE": (900, 905, 510, 390, 0.05, -0.02, 0.01, 0.002),
    "FULL_OPENCV": (900, 905, 510, 390, *[0.01] * 8),
}


def write_model(folder: Path, lens: str, scene: WorldScene = SCENE) -> Path:
    """A model of the scene with a lens, in COLMAP's files."""
    camera = pycolmap.Camera.create_from_model_name(1, lens, 1.0, *IMAGE)
    camera.params = [float(value) for value in LENSES[lens]]
    return write_colmap(scene, folder, camera)


@pytest.fixture
def images(tmp_path: Path) -> Path:
    """The images of the scene: red is x, green is y, a level for each 4 pixels."""
    folder = tmp_path / "images"
    folder.mkdir()
    y, x = np.indices(IMAGE[::-1])
    for name in SCENE.names:
        cv2.imwrite(str(folder / name), np.dstack([0 * x, y // 4, x // 4]))
    return folder


@pytest.mark.parametrize("lens", [name for name in LENSES if name != "FULL_OPENCV"])
def test_nerfstudio_shows_the_points_where_the_images_do(
    lens: str, images: Path, tmp_path: Path
) -> None:
    """By OpenCV's projections with the intrinsics and the matrix of the file."""
    model = write_model(tmp_path / "out" / "sparse", lens)
    done = run("export", model.parent, "--to", "nerfstudio", "--out", tmp_path / "nerf")
    assert (done.exit_code, done.stderr) == (0, ""), done.output
    assert done.stdout == f"{tmp_path / 'nerf'}: 5 images for nerfstudio\n"
    data = json.loads((tmp_path / "nerf" / "transforms.json").read_text())
    assert data["camera_model"] == ("OPENCV_FISHEYE" if "FISHEYE" in lens else "OPENCV")
    written = pycolmap.Reconstruction(model)
    assert {frame["file_path"] for frame in data["frames"]} == {*SCENE.names}
    for frame in data["frames"]:
        observed = written.find_image_with_name(frame["file_path"]).points2D
        pixels = np.stack([point.xy for point in observed])
        cam_from_world = np.diag([1, -1, -1, 1]) @ np.linalg.inv(frame["transform_matrix"])
        cam = SCENE.points @ cam_from_world[:3, :3].T + cam_from_world[:3, 3]
        fx, fy, cx, cy = (frame[key] for key in ("fl_x", "fl_y", "cx", "cy"))
        K, zero = np.array([[fx, 0, cx], [0, fy, cy], [0, 0, 1]]), np.zeros(3)
        keys = ("k1", "k2", "k3", "k4") if "FISHEYE" in lens else ("k1", "k2", "p1", "p2")
        project = cv2.fisheye.projectPoints if "FISHEYE" in lens else cv2.projectPoints
        lens_values = np.array([frame.get(key, 0.0) for key in keys])
        projected, _ = project(cam[:, None], zero, zero, K, lens_values)
        np.testing.assert_allclose(projected[:, 0], pixels, atol=1e-6)
        assert (frame["w"], frame["h"]) == IMAGE
    points = pycolmap.Reconstruction()
    points.import_PLY(tmp_path / "nerf" / data["ply_file_path"])
    cloud = np.stack([point.xyz for point in points.points3D.values()])
    np.testing.assert_allclose(np.sort(cloud, 0), np.sort(SCENE.points, 0), atol=1e-5)


def test_nerfstudio_is_read_by_locate_with_the_same_cameras(images: Path, tmp_path: Path) -> None:
    """In folders whose photographs have one name; the file is written through a link, and its paths
    lead to the photographs from where it is."""
    written = pycolmap.Reconstruction(write_model(tmp_path / "model", "OPENCV"))
    for number, image in written.images.items():
        (images / f"{number}").mkdir()
        (images / image.name).rename(images / f"{number}" / "1.jpg")
        image.name = f"{number}/1.jpg"
    written.write_binary(tmp_path / "model")
    (tmp_path / "deep" / "er").mkdir(parents=True)
    (tmp_path / "link").symlink_to(tmp_path / "deep" / "er")
    words = ("--to", "nerfstudio", "--images", images, "--out", tmp_path / "link" / "nerf")
    assert run("export", tmp_path / "model", *words).exit_code == 0
    file = tmp_path / "deep" / "er" / "nerf" / "transforms.json"
    for frame in json.loads(file.read_text())["frames"]:
        assert (file.parent / frame["file_path"]).is_file()
    exported, original = (load_model(path, images) for path in (file, tmp_path / "model"))
    assert exported.poses.keys() == original.poses.keys() == {f"{i}/1.jpg" for i in written.images}
    for name, pose in original.poses.items():
        np.testing.assert_allclose(exported.poses[name], pose, atol=1e-12)
        np.testing.assert_allclose(exported.cameras[name].K, original.cameras[name].K)
        assert exported.cameras[name].distortion == original.cameras[name].distortion


@pytest.mark.parametrize(
    ("names", "times"),
    [
        (["9.5.jpg", "10.25.jpg", "a/1305031102.175304.png"], [9.5, 10.25, 1305031102.175304]),
        (["left.jpg", "a 1.jpg", "2.jpg"], [2, 1, 0]),
    ],
)
def test_tum_has_a_time_and_the_pose_of_each_camera(
    names: list[str], times: list[float], tmp_path: Path
) -> None:
    model = pycolmap.Reconstruction(write_model(tmp_path / "model", "PINHOLE"))
    for number, name in enumerate(names, start=1):
        model.images[number].name = name
    for number in (4, 5):
        model.deregister_frame(model.images[number].frame_id)
    model.write_text(tmp_path / "model")
    for path in (tmp_path / "model").glob("*.bin"):
        path.unlink()
    assert run("export", tmp_path / "model", "--to", "tum", "--out", tmp_path / "t").exit_code == 0
    table = np.loadtxt(tmp_path / "t" / "trajectory.txt")
    assert (np.diff(table[:, 0]) > 0).all() and len(table) == 3
    for time, (R, centre) in zip(times, SCENE.references, strict=False):
        (row,) = table[table[:, 0] == time]
        np.testing.assert_allclose(row[1:4], centre, atol=1e-9)
        np.testing.assert_allclose(Rotation.from_quat(row[4:]).as_matrix(), R.T, atol=1e-9)


def test_openmvs_has_images_without_distortion(images: Path, tmp_path: Path) -> None:
    """A pixel has the colour of the place that the lens puts its ray at; the points are where the
    pinholes see them, in both of COLMAP's forms."""
    model = write_model(tmp_path / "model", "OPENCV")
    words = ("--to", "openmvs", "--images", images, "--out", tmp_path / "mvs")
    done = run("export", model, *words)
    assert (done.exit_code, done.stderr) == (0, ""), done.output
    fx, fy, cx, cy, *lens = LENSES["OPENCV"]
    for path in (tmp_path / "mvs" / "sparse").glob("*.bin"):
        path.unlink()
    undistorted = pycolmap.Reconstruction(tmp_path / "mvs" / "sparse")  # the text
    splatted = pycolmap.Reconstruction(tmp_path / "mvs" / "sparse" / "0")  # of Gaussian splatting
    assert splatted.num_points3D() == undistorted.num_points3D() == len(SCENE.points)
    assert splatted.cameras[1].params.tolist() == undistorted.cameras[1].params.tolist()
    for image in undistorted.images.values():
        assert image.camera.model.name == "PINHOLE"
        pixels = cv2.imread(str(tmp_path / "mvs" / "images" / image.name))
        assert pixels.shape[1::-1] == (image.camera.width, image.camera.height)
        ideal = image.camera.img_from_cam(
            SCENE.points @ np.array(image.cam_from_world().rotation.matrix()).T
            + image.cam_from_world().translation
        )
        seen = np.stack([point.xy for point in image.points2D])
        np.testing.assert_allclose(seen, ideal, atol=1e-3)
        for x, y in ((30, 20), (500, 400), (900, 100), (700, 650)):
            ray = np.append(image.camera.cam_from_img((x + 0.5, y + 0.5)), 1.0)
            K = np.array([[fx, 0, cx], [0, fy, cy], [0, 0, 1]], np.float64)
            place, _ = cv2.projectPoints(ray[None], np.zeros(3), np.zeros(3), K, np.array(lens))
            np.testing.assert_allclose(4.0 * pixels[y, x, :0:-1], place[0, 0], atol=10)


@pytest.mark.parametrize("ending", ["jpg", "png"])
def test_openmvs_keeps_blanks_in_names_and_drops_the_turn_of_photographs(
    ending: str, images: Path, tmp_path: Path
) -> None:
    """A photograph that EXIF data turn has the pixels that it has without them: its camera is of
    the pixels as they are stored. A text of COLMAP's cannot hold the blank, and is not there."""
    written = pycolmap.Reconstruction(write_model(tmp_path / "model", "OPENCV"))
    exif = PIL.Image.Exif()
    exif[271], exif[274] = "Maker", 6
    (tmp_path / "upright").mkdir()
    for number, image in written.images.items():
        pixels = PIL.Image.open(images / image.name)
        image.name = f"IMG {number}.{ending}"
        pixels.save(images / image.name, exif=exif)
        pixels.save(tmp_path / "upright" / image.name)
    written.write_binary(tmp_path / "model")
    for folder, out in ((images, "turned"), (tmp_path / "upright", "plain")):
        words = ("--to", "openmvs", "--images", folder, "--out", tmp_path / out)
        assert run("export", tmp_path / "model", *words).exit_code == 0
    for image in written.images.values():
        turned, plain = (
            PIL.Image.open(tmp_path / out / "images" / image.name) for out in ("turned", "plain")
        )
        assert turned.getexif().get(274, 1) == 1
        np.testing.assert_array_equal(np.asarray(turned), np.asarray(plain))
        if ending == "jpg":  # the rest of the file is as it was
            assert turned.getexif().get(271) == "Maker"
    assert pycolmap.Reconstruction(tmp_path / "turned" / "sparse" / "0").num_images() == 5
    assert not list((tmp_path / "turned" / "sparse").glob("*.txt"))


def test_unusable_input_is_one_line_and_leaves_nothing(images: Path, tmp_path: Path) -> None:
    model = write_model(tmp_path / "model", "OPENCV")
    full = write_model(tmp_path / "full", "FULL_OPENCV")
    cut = write_model(tmp_path / "cut", "OPENCV")
    (cut / "images.bin").write_bytes((cut / "images.bin").read_bytes()[:150])
    mixed = pycolmap.Reconstruction(write_model(tmp_path / "mixed", "OPENCV_FISHEYE"))
    other = pycolmap.Camera.create_from_model_name(2, "PINHOLE", 900.0, *IMAGE)
    mixed.add_camera_with_trivial_rig(other)
    image = pycolmap.Image(name="other.jpg", camera_id=2, image_id=9)
    mixed.add_image_with_trivial_frame(image, pycolmap.Rigid3d())
    mixed.write_binary(tmp_path / "mixed")
    outside = pycolmap.Reconstruction(write_model(tmp_path / "outside", "OPENCV"))
    for number, image in outside.images.items():
        image.name = f"../images/{SCENE.names[number - 1]}"
    outside.write_binary(tmp_path / "outside")
    small, nowhere = tmp_path / "small", tmp_path / "nowhere"
    small.mkdir()
    for name in SCENE.names:
        cv2.imwrite(str(small / name), np.zeros((10, 20), np.uint8))
    before = contents(tmp_path)
    for source, to, words, expected in (
        (images, "tum", (), "holds no model of COLMAP"),
        (cut, "tum", (), "images.bin is not COLMAP's images that can be read"),
        (full, "nerfstudio", (), "--to nerfstudio cannot hold FULL_OPENCV"),
        (tmp_path / "mixed", "nerfstudio", (), "cannot hold OPENCV_FISHEYE, PINHOLE"),
        (model, "nerfstudio", ("--images", nowhere), "nowhere: No such file"),
        (model, "openmvs", (), "--images is needed for openmvs"),
        (model, "openmvs", ("--images", nowhere), ".jpg cannot be read: No such file"),
        (model, "openmvs", ("--images", small), "20 x 10 is not its camera's size"),
        (tmp_path / "outside", "openmvs", ("--images", images), "does not hold the model's ../im"),
        (model, "bundle", (), "'nerfstudio', 'openmvs', 'tum'"),
    ):
        refused = run("export", source, "--to", to, *words, "--out", tmp_path / "o")
        assert_refused(refused, expected)
    there = run("export", model, "--to", "tum", "--out", images)
    assert_refused(there, f"--out {images} is there already")
    assert contents(tmp_path) == before
