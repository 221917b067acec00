"""Models as files have them, and what is refused."""

import codecs
import json
from pathlib import Path

import cv2
import numpy as np
import PIL.Image
import pycolmap
import pytest
from worlds import CAMERA, IMAGE, WorldScene, world_scene, write_colmap

from dgc_pose.cameras.camera import Camera
from dgc_pose.cameras.colmap_camera import Distortion
from dgc_pose.errors import DgcPoseError, InputError
from dgc_pose.geometry.rotation import quaternion_wxyz
from dgc_pose.model import Model, load_model, read_colmap

SCENE = world_scene(count=20)


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


@pytest.mark.parametrize("kind", ["binary", "text", "table", "transforms", "results"])
def test_models_have_the_poses_of_their_files(kind: str, images: Path, tmp_path: Path) -> None:
    if kind == "table":
        source = _table(SCENE, tmp_path / "poses.csv")
    elif kind == "transforms":
        source = _transforms(SCENE, tmp_path / "transforms.json")
    elif kind == "results":
        source = write_colmap(SCENE, tmp_path / "out" / "sparse").parent
    else:
        source = write_colmap(SCENE, tmp_path / "model", binary=kind == "binary")
    model = load_model(source, images)
    assert sorted(model.poses) == SCENE.names
    for name, (R, centre) in zip(SCENE.names, SCENE.references, strict=True):
        np.testing.assert_allclose(model.poses[name][:, :3], R, atol=1e-9)
        np.testing.assert_allclose(model.centre(name), centre, atol=1e-9)
        np.testing.assert_allclose(model.cameras[name].K, CAMERA.K, atol=1e-9)
    centres = np.stack([centre for _, centre in SCENE.references])
    furthest = max(np.linalg.norm(a - b) for a in centres for b in centres)
    assert model.extent == pytest.approx(furthest)
    with pytest.MonkeyPatch.context() as patched:
        patched.setattr(Model, "centre", None)
        assert model.extent == pytest.approx(furthest)  # it is known
    if kind in ("binary", "text", "results"):
        assert sorted(model.seen) == SCENE.names[:2] and len(model.points) == len(SCENE.points)
        which, pixels = model.seen[SCENE.names[1]]
        xyz = model.points[which]
        order = [int(np.abs(SCENE.points - p).sum(1).argmin()) for p in xyz]
        expected = SCENE.pixels(CAMERA, *SCENE.references[1])[order]
        np.testing.assert_allclose(pixels, expected, atol=1e-6)


def test_images_that_are_missing_are_told(images: Path, tmp_path: Path) -> None:
    source = _table(SCENE, tmp_path / "poses.csv")
    (images / "r1.jpg").unlink()
    model = load_model(source, images)
    assert "r1.jpg" not in model.poses
    assert "lacks 1 of 5 images (first: r1.jpg)" in model.warnings[0]
    for name in SCENE.names[2:]:
        (images / name).unlink()
    with pytest.raises(InputError, match=r"images .* lacks 4 of 5 images \(first: r1.jpg, "):
        load_model(source, images)


def test_what_is_no_model_is_refused(images: Path, tmp_path: Path) -> None:
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
        (odd, "has a pose that is none"),
        (images, "holds no model of COLMAP"),
        (single, "model .*single.csv has the pose of one image, two are needed"),
    ):
        with pytest.raises(DgcPoseError, match=words):
            load_model(source, images)


@pytest.mark.parametrize("kind", ["binary", "table"])
@pytest.mark.parametrize("orientation", [1, 3, 6, 8])
def test_a_turned_photograph_is_added_for_its_pixels_as_stored(
    orientation: int, kind: str, images: Path, tmp_path: Path
) -> None:
    """Points of the world are where they are in the file, by Pillow's own turn of the pixels."""
    stored = PIL.Image.fromarray(np.arange(120 * 160, dtype=np.int32).reshape(120, 160))
    exif = PIL.Image.Exif()
    exif[0x112] = orientation
    photo = images / "new.jpg"
    PIL.Image.new("L", stored.size).save(photo, exif=exif)
    turn = {3: 3, 6: 4, 8: 2}.get(orientation)  # PIL.Image.Transpose
    upright = np.asarray(stored if turn is None else stored.transpose(PIL.Image.Transpose(turn)))
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
        ([first, second], r"add has an image new.png already, not .*b.new.png too"),
        ([tmp_path / SCENE.names[-1]], f"add has an image {SCENE.names[-1]} already"),
        ([tmp_path / "mirrored.jpg"], "by EXIF orientation 5 its pixels are a mirror image"),
    ):
        with pytest.raises(InputError, match=words):
            model.require_addable(tmp_path / "out", paths)
    model.require_addable(tmp_path / "out", [first])


@pytest.mark.parametrize("name", ["cameras", "images", "points3D"])
def test_a_text_of_colmap_may_have_a_byte_order_mark(
    name: str, images: Path, tmp_path: Path
) -> None:
    source = write_colmap(SCENE, tmp_path / "model", binary=False)
    plain, text = load_model(source, images), source / f"{name}.txt"
    text.write_bytes(codecs.BOM_UTF8 + text.read_bytes())
    model = load_model(source, images)
    assert sorted(model.poses) == SCENE.names and len(read_colmap(source).images) > 0
    np.testing.assert_array_equal(model.points, plain.points)
