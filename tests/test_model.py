"""Models as files have them, and what is refused."""

import codecs
import json
from pathlib import Path

import cv2
import numpy as np
import PIL.Image
import pycolmap
import pytest
from command_line import assert_refused, contents, run
from worlds import CAMERA, IMAGE, WorldScene, world_scene, write_colmap

from dgc_pose.cameras.camera import Camera
from dgc_pose.cameras.colmap_camera import Distortion
from dgc_pose.errors import DgcPoseError, ImageError, InputError
from dgc_pose.geometry.rotation import quaternion_wxyz
from dgc_pose.model import load_model, read_colmap

SCENE = world_scene(count=20)
LENSES = {
    "OPENCV": (900, 905, 510, 390, -0.15, 0.02, 0.003, -0.002),
    "OPENCV_FISHEYE": (900, 905, 510, 390, 0.05, -0.02, 0.01, 0.002),
    "FULL_OPENCV": (900, 905, 510, 390, *[0.01] * 8),
}


@pytest.fixture
def images(tmp_path: Path) -> Path:
    """The images of the scene, blank."""
    folder = tmp_path / "images"
    folder.mkdir()
    for name in SCENE.names:
        cv2.imwrite(str(folder / name), np.zeros(IMAGE[::-1], np.uint8))
    return folder


def _table(scene: WorldScene, path: Path) -> Path:
    lines = ["name,qw,qx,qy,qz,tx,ty,tz,fx,fy,cx,cy"]
    fx, fy, cx, cy = CAMERA.K[0, 0], CAMERA.K[1, 1], *CAMERA.K[:2, 2]
    for name, (R, centre) in zip(scene.names, scene.references, strict=True):
        values = (*quaternion_wxyz(R).tolist(), *(-R @ centre).tolist(), fx, fy, cx, cy)
        lines.append(",".join([name, *map(repr, map(float, values))]))
    path.write_text("\n".join(lines))
    return path


def _transforms(scene: WorldScene, path: Path) -> Path:
    """As nerfstudio writes it: camera axes right, up and backwards."""
    frames = []
    for name, (R, centre) in zip(scene.names, scene.references, strict=True):
        matrix = np.eye(4)
        matrix[:3, :3], matrix[:3, 3] = R.T @ np.diag([1, -1, -1]), centre
        stem = f"./images/{Path(name).stem}"  # as of NeRF's own scenes
        frames.append({"file_path": stem, "transform_matrix": matrix.tolist()})
    data = {"w": IMAGE[0], "h": IMAGE[1], "fl_x": 900.0, "fl_y": 905.0, "frames": frames}
    path.write_text(json.dumps(data | {"cx": 500.5, "cy": 390.5}))
    return path


@pytest.mark.parametrize("kind", ["text", "table", "transforms", "results"])
def test_models_have_the_poses_of_their_files(kind: str, images: Path, tmp_path: Path) -> None:
    """A text may have a byte order mark."""
    if kind == "table":
        source = _table(SCENE, tmp_path / "poses.csv")
    elif kind == "transforms":
        source = _transforms(SCENE, tmp_path / "transforms.json")
    elif kind == "results":
        source = write_colmap(SCENE, tmp_path / "out" / "sparse").parent
    else:
        source = write_colmap(SCENE, tmp_path / "model", binary=False)
        for text in (source / "images.txt", source / "points3D.txt"):
            text.write_bytes(codecs.BOM_UTF8 + text.read_bytes())
        assert len(read_colmap(source).images) > 0
    model = load_model(source, images)
    assert sorted(model.poses) == SCENE.names
    for name, (R, centre) in zip(SCENE.names, SCENE.references, strict=True):
        np.testing.assert_allclose(model.poses[name][:, :3], R, atol=1e-9)
        np.testing.assert_allclose(model.centre(name), centre, atol=1e-9)
        np.testing.assert_allclose(model.cameras[name].K, CAMERA.K, atol=1e-9)
    centres = np.stack([centre for _, centre in SCENE.references])
    furthest = max(np.linalg.norm(a - b) for a in centres for b in centres)
    assert model.extent == pytest.approx(furthest)
    if kind in ("text", "results"):
        assert sorted(model.seen) == SCENE.names[:2] and len(model.points) == len(SCENE.points)
        which, pixels = model.seen[SCENE.names[1]]
        xyz = model.points[which]
        order = [int(np.abs(SCENE.points - p).sum(1).argmin()) for p in xyz]
        expected = SCENE.pixels(CAMERA, *SCENE.references[1])[order]
        np.testing.assert_allclose(pixels, expected, atol=1e-6)


def test_what_is_no_model_is_refused_and_missing_images_are_told(
    images: Path, tmp_path: Path
) -> None:
    write_colmap(SCENE, tmp_path / "two" / "0")
    write_colmap(SCENE, tmp_path / "two" / "1")
    cameras = tmp_path / "cameras.csv"
    cameras.write_text("name,fx,fy,cx,cy\nr0.jpg,900,900,500,400\n")
    odd = tmp_path / "odd.json"
    data = json.loads(_transforms(SCENE, odd).read_text())
    data["frames"][0]["transform_matrix"] = (2 * np.eye(4)).tolist()
    odd.write_text(json.dumps(data))
    single = tmp_path / "single.csv"
    single.write_text("\n".join(_table(SCENE, single).read_text().splitlines()[:2]))
    for source, words in (
        (tmp_path / "two", "model .*two has the models 0, 1"),
        (cameras, "model .* has no poses of images"),
        (odd, "the pose of .* is not rigid"),
        (images, "contains no COLMAP model"),
        (single, "model .*single.csv has one posed image, and two are needed"),
    ):
        with pytest.raises(DgcPoseError, match=words):
            load_model(source, images)
    # Images that are missing are told, unless one alone is left.
    (images / "r1.jpg").unlink()
    model = load_model(_table(SCENE, single), images)
    assert "r1.jpg" not in model.poses
    assert "lacks 1 of 5 images (first: r1.jpg)" in model.warnings[0]
    # So are those that are broken or of another size.
    (images / "r2.jpg").write_bytes(b"no image")
    broken = load_model(single, images)
    assert sorted(broken.poses) == ["r0.jpg", "r3.jpg", "r4.jpg"]
    (line,) = broken.warnings[1:]
    assert (
        line == f"not used: {broken.bad['r2.jpg']}"
        and "r2.jpg is not an image of a known format" in line
    )
    for name in ("r3.jpg", "r4.jpg"):
        cv2.imwrite(str(images / name), np.zeros((5, 4), np.uint8))
    with pytest.raises(ImageError, match="r2.jpg is not an image of a known format"):
        load_model(single, images)
    for name in SCENE.names[2:]:
        (images / name).unlink()
    with pytest.raises(InputError, match=r"images .* lacks 4 of 5 images \(first: r1.jpg, "):
        load_model(single, images)


@pytest.mark.parametrize(("kind", "orientation"), [("binary", 1), ("table", 6)])
def test_a_turned_photograph_is_added_for_its_pixels_as_stored(
    orientation: int, kind: str, images: Path, tmp_path: Path
) -> None:
    """Points of the world are where they are in the file, by Pillow's own turn of the pixels."""
    stored = PIL.Image.fromarray(np.arange(120 * 160, dtype=np.int32).reshape(120, 160))
    exif = PIL.Image.Exif()
    exif[0x112] = orientation
    photo = images / "new.jpg"
    PIL.Image.new("L", stored.size).save(photo, exif=exif)
    turned = stored.transpose(PIL.Image.Transpose.ROTATE_270)
    upright = np.asarray(turned if orientation == 6 else stored)
    lens = Distortion("OPENCV", (0.05, -0.02, 0.01, -0.02))
    matrix = np.array([[100.0, 0, 70], [0, 110, 65], [0, 0, 1]])
    camera = Camera(matrix, upright.shape[::-1], lens)
    pose = np.column_stack([SCENE.R, -SCENE.R @ SCENE.centre])
    table = _table(SCENE, tmp_path / "poses.csv")
    source = load_model(write_colmap(SCENE, tmp_path / "m") if kind == "binary" else table, images)
    source.require_addable(tmp_path / "out", [str(photo)])
    source.write(tmp_path / "out", {photo: (camera, pose)})
    model = pycolmap.Reconstruction(tmp_path / "out")
    assert model.num_images() == 6 and model.num_points3D() == (20 if kind == "binary" else 0)
    added = model.find_image_with_name("new.jpg")
    assert added is not None
    as_stored = model.cameras[added.camera_id]
    assert (as_stored.width, as_stored.height) == (160, 120)
    for point in SCENE.points:
        x, y, z = pose[:, :3] @ point + pose[:, 3]
        at = camera.project(np.array([[x / z, y / z]]))[0]
        in_file = as_stored.img_from_cam(added.cam_from_world() * point) - 0.5
        column, line = np.round(at).astype(int)
        if 0 <= column < upright.shape[1] and 0 <= line < upright.shape[0]:
            y, x = divmod(int(upright[line, column]), 160)
            assert np.abs(in_file - (x, y)).max() <= 0.5 + 1e-6
    again = load_model(tmp_path / "out", images)
    np.testing.assert_allclose(again.poses["new.jpg"], pose, atol=1e-9)
    np.testing.assert_allclose(again.cameras["new.jpg"].K, matrix)


def test_photographs_that_cannot_be_added_are_told(images: Path, tmp_path: Path) -> None:
    source = write_colmap(SCENE, tmp_path / "m")
    (images / SCENE.names[-1]).rename(tmp_path / SCENE.names[-1])  # the model has it all the same
    model = load_model(source, images)
    first, second = tmp_path / "a" / "new.png", tmp_path / "b" / "new.png"
    for path in (first, second):
        path.parent.mkdir()
        cv2.imwrite(str(path), np.zeros((12, 16), np.uint8))
    exif = PIL.Image.Exif()
    exif[0x112] = 5
    PIL.Image.new("L", (16, 12)).save(tmp_path / "mirrored.jpg", exif=exif)
    for paths, words in (
        ([first, second], r"add has an image new.png already: rename .*b.new.png"),
        ([tmp_path / SCENE.names[-1]], f"add has an image {SCENE.names[-1]} already"),
        ([tmp_path / "mirrored.jpg"], "by EXIF orientation 5 its pixels are a mirror image"),
    ):
        with pytest.raises(InputError, match=words):
            model.require_addable(tmp_path / "out", paths)
    model.require_addable(tmp_path / "out", [first])


def _with_lens(folder: Path, lens: str) -> Path:
    """A COLMAP model of the scene with a lens."""
    camera = pycolmap.Camera.create_from_model_name(1, lens, 1.0, *IMAGE)
    camera.params = [float(value) for value in LENSES[lens]]
    return write_colmap(SCENE, folder, camera)


@pytest.mark.parametrize("lens", ["OPENCV", "OPENCV_FISHEYE"])
def test_nerfstudio_shows_the_points_where_the_images_do(
    lens: str, images: Path, tmp_path: Path
) -> None:
    """By OpenCV's projections with the intrinsics and the matrix of the file."""
    model = _with_lens(tmp_path / "out" / "sparse", lens)
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
    written = pycolmap.Reconstruction(_with_lens(tmp_path / "model", "OPENCV"))
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


def test_what_nerfstudio_cannot_hold_is_one_line_and_leaves_nothing(
    images: Path, tmp_path: Path
) -> None:
    model, full = (_with_lens(tmp_path / lens, lens) for lens in ("OPENCV", "FULL_OPENCV"))
    cut = _with_lens(tmp_path / "cut", "OPENCV")
    (cut / "images.bin").write_bytes((cut / "images.bin").read_bytes()[:150])
    mixed = pycolmap.Reconstruction(_with_lens(tmp_path / "mixed", "OPENCV_FISHEYE"))
    other = pycolmap.Camera.create_from_model_name(2, "PINHOLE", 900.0, *IMAGE)
    mixed.add_camera_with_trivial_rig(other)
    image = pycolmap.Image(name="other.jpg", camera_id=2, image_id=9)
    mixed.add_image_with_trivial_frame(image, pycolmap.Rigid3d())
    mixed.write_binary(tmp_path / "mixed")
    before = contents(tmp_path)
    for source, words, expected in (
        (images, (), "contains no COLMAP model"),
        (cut, (), "images.bin cannot be read as COLMAP's images"),
        (full, (), "--to nerfstudio cannot hold FULL_OPENCV"),
        (tmp_path / "mixed", (), "cannot hold OPENCV_FISHEYE, PINHOLE"),
        (model, ("--images", tmp_path / "nowhere"), "nowhere: No such file"),
    ):
        words = ("--to", "nerfstudio", *words, "--out", tmp_path / "o")
        assert_refused(run("export", source, *words), expected)
    there = run("export", model, "--to", "nerfstudio", "--out", images)
    assert_refused(there, f"--out {images} exists already")
    assert contents(tmp_path) == before
