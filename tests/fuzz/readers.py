"""The readers of files that users have, with good files that the tests make themselves."""

import json
from collections.abc import Callable
from contextlib import suppress
from pathlib import Path

import cv2
import dense_scene
import numpy as np
import PIL.Image
import pycolmap
import torch
from PIL.TiffImagePlugin import IFDRational

from dgc_pose.batch.plan import Plan
from dgc_pose.batch.result import read_batch, summary_of, write_files
from dgc_pose.batch.rows import BAD_INPUT, MatchedPair, PairRow, row_of
from dgc_pose.batch.store import open_store
from dgc_pose.benchmarks.stored_matches import FileMatcher
from dgc_pose.cameras.calibration import parse_camera, read_calibration
from dgc_pose.cameras.camera import Camera
from dgc_pose.cameras.colmap_camera import Distortion
from dgc_pose.cameras.formats.colmap import read_database
from dgc_pose.cameras.pair_list import read_pair_list, read_pairs
from dgc_pose.cameras.prior import auto_camera
from dgc_pose.colmap.export import pair_geometries
from dgc_pose.estimation import RelativePose
from dgc_pose.estimation.hypothesis import Hypothesis
from dgc_pose.images.image import Image, image_header, image_size, load_image, read_pixels
from dgc_pose.matches import Matches
from dgc_pose.network.config import preset
from dgc_pose.network.net import DGCNet
from dgc_pose.network.weights import load_network
from dgc_pose.training.run import save_weights

Make = Callable[[Path], object]  # writes good files into a folder
Read = Callable[[Path, Path], object]  # of the folder and the damaged file in it


def _pixels(size: tuple[int, int] = (40, 30)) -> np.ndarray:
    rng = np.random.default_rng(0)
    return cv2.resize(rng.integers(0, 256, (5, 7, 3), np.uint8), size)


def _make_images(folder: Path) -> None:
    picture = PIL.Image.fromarray(_pixels())
    for ending in ("png", "jpg", "tiff", "bmp", "ppm", "webp", "gif", "jp2", "avif"):
        with suppress(KeyError, OSError, ValueError):  # a Pillow without that format
            picture.save(folder / f"plain.{ending}")
    with suppress(ImportError):
        import pillow_heif

        pillow_heif.from_pillow(picture).save(folder / "plain.heic")
    exif = picture.getexif()
    exif[0x0112], exif[0x010F], exif[0x0110] = 6, "Canon", "EOS"
    exif.get_ifd(0x8769).update({0x920A: IFDRational(35, 1), 0xA405: 35, 0xA002: 80, 0xA003: 60})
    picture.save(folder / "turned.jpeg", exif=exif)
    exif[0x0112] = 1
    picture.save(folder / "camera.tiff", exif=exif.tobytes())
    picture.convert("P").save(folder / "palette.png")
    picture.save(folder / "packed.tiff", compression="tiff_lzw")
    deep = _pixels().astype(np.uint16) * 200
    floats = _pixels().astype(np.float32) / 255
    for name, pixels in (
        ("deep.png", deep),
        ("deep.tiff", deep),
        ("deep.pgm", deep[:, :, 0]),
        ("floats.tiff", floats),
    ):
        cv2.imwrite(str(folder / name), pixels)


def _read_image(folder: Path, path: Path) -> None:
    try:
        image_size(path)
    finally:
        image = load_image(path)
    assert image.pixels.dtype == np.uint8 and image.pixels.shape[2] == 3
    read_pixels(path)


def _make_cameras(folder: Path) -> None:
    (folder / "K.txt").write_text("300 0 159.5\n0 300 119.5\n0 0 1\n")
    (folder / "line.txt").write_text("\ufeff300 0 159.5 0 300 119.5 0 0 1", encoding="utf-8")
    np.save(folder / "K.npy", dense_scene.K)
    (folder / "pinhole.arg").write_text(dense_scene.K_TEXT)
    (folder / "opencv.arg").write_text("OPENCV,320,240,300,300,160,120,0.1,0.01,0,0")
    (folder / "radial.arg").write_text("SIMPLE_RADIAL,320,240,300,160,120,-0.1")


def _read_camera(folder: Path, path: Path) -> None:
    text = str(path)
    if path.suffix == ".arg":  # what a user might type
        text = path.read_bytes().decode("utf-8", "surrogateescape")
    parse_camera(text).normalise(np.array([[10.0, 20.0]]))


def _make_calibrations(folder: Path) -> None:
    (folder / "table.csv").write_text("name,fx,fy,cx,cy,width,height\na.png,9,9,4,3,10,8\n")
    frames = [{"file_path": "./a.png", "transform_matrix": np.eye(4).tolist()}]
    nerf = {"fl_x": 9.0, "fl_y": 9.0, "cx": 5, "cy": 4, "w": 10, "h": 8, "frames": frames}
    (folder / "transforms.json").write_text(json.dumps(nerf))
    storage = cv2.FileStorage(str(folder / "opencv.yml"), cv2.FILE_STORAGE_WRITE)
    storage.write("camera_matrix", dense_scene.K)
    storage.write("distortion_coefficients", np.array([0.1, 0.01, 0.0, 0.0]))
    storage.release()
    (folder / "ros.yaml").write_text(
        "image_width: 10\nimage_height: 8\ndistortion_model: plumb_bob\n"
        "camera_matrix: {data: [9, 0, 5, 0, 9, 4, 0, 0, 1]}\n"
    )
    (folder / "kalibr.yaml").write_text("cam0: {intrinsics: [9, 9, 5, 4], resolution: [10, 8]}\n")
    (folder / "pose.json").write_text(json.dumps({"K1": [9, 9, 5, 4], "K2": [9, 9, 5, 4]}))
    (folder / "calib.txt").write_text("P0: 9 0 4 0 0 9 3 0 0 0 1 0\nP1: 9 0 4 0 0 9 3 0 0 0 1 0\n")
    model = pycolmap.Reconstruction()
    camera = pycolmap.Camera.create_from_model_name(1, "OPENCV", 9.0, 10, 8)
    model.add_camera_with_trivial_rig(camera)
    image = pycolmap.Image(name="a.png", camera_id=1, image_id=1)
    image.points2D = pycolmap.Point2DList([pycolmap.Point2D([2.0, 3.0])])
    model.add_image_with_trivial_frame(image, pycolmap.Rigid3d())
    for name in ("text", "binary"):
        (folder / name).mkdir()
    model.write_text(folder / "text")
    model.write_binary(folder / "binary")


def _read_calibration(folder: Path, path: Path) -> None:
    read_calibration(str(path if path.parent == folder else path.parent))


def _make_database(folder: Path) -> None:
    with pycolmap.Database.open(folder / "a.db") as database:
        camera = pycolmap.Camera.create_from_model_name(1, "PINHOLE", 9.0, 10, 8)
        camera.has_prior_focal_length = True
        database.write_camera(camera, use_camera_id=True)
        for number in (1, 2):
            image = pycolmap.Image(name=f"{number}.png", camera_id=1, image_id=number)
            database.write_image(image, use_image_id=True)
        database.write_matches(1, 2, np.array([[0, 0], [1, 1]], np.uint32))


def _make_pair_list(folder: Path) -> None:
    dense_scene.write_pair_list(folder, pairs=2)
    for picture in folder.glob("*.png"):
        picture.unlink()


def _make_batch_lists(folder: Path) -> None:
    (folder / "plain.txt").write_text("a.png b.png\n# c\na.png c.png\n")
    (folder / "table.csv").write_text("name1,name2\na.png,b.png\n")
    _make_pair_list(folder)


def _make_weights(folder: Path) -> None:
    torch.manual_seed(0)
    save_weights(DGCNet(preset("dgcm-lite0")), folder / "a.safetensors")
    state = {"pyramid.level_0.0.weight": torch.zeros(64, 3, 3, 3), "x": torch.ones(3)}
    torch.save({"state_dict": state}, folder / "a.pth")
    torch.save(state, folder / "legacy.pth", _use_new_zipfile_serialization=False)


def _make_matches(folder: Path) -> None:
    """A folder of each format, as `--matches` takes them."""
    flow = np.random.default_rng(0).normal(size=(30, 40, 2)).astype(np.float32)
    for name in ("flo", "npy", "flow", "map", "points", "kitti"):
        (folder / name).mkdir()
    cv2.writeOpticalFlow(str(folder / "flo/pair.flo"), flow)
    np.save(folder / "npy/pair.npy", flow)
    np.savez(folder / "flow/pair.npz", flow=flow, certainty=np.ones((30, 40)))
    grid = np.stack(np.meshgrid(np.arange(40.0), np.arange(30.0)), -1)
    maps = {"map": grid + 1, "grid": grid, "matchability": np.ones((30, 40))}
    np.savez_compressed(folder / "map/pair.npz", **maps)
    points = {"points1": grid.reshape(-1, 2), "points2": grid.reshape(-1, 2), "error_px": 1.0}
    np.savez(folder / "points/pair.npz", **points, confidence=np.ones(1200), key_points=True)
    kitti = np.dstack([np.ones((30, 40)), flow[..., ::-1] * 64 + 2**15]).astype(np.uint16)
    cv2.imwrite(str(folder / "kitti/pair.png"), kitti)


def _read_matches(folder: Path, path: Path) -> None:
    images = [Image(_pixels(), name) for name in ("one", "two")]
    FileMatcher("files", {("one", "two"): path}).match(*images)


def make_batch(folder: Path) -> None:
    """A finished batch: a pose of two images, and a pair with a bad image."""
    plan = make_unfinished_batch(folder)
    with open_store(folder) as store, store.change():
        store.add("result", list(store.pairs("matched")))
        summary = summary_of(plan, store.rows("result"), []) | {"matched_now": 2, "seconds": 0.5}
        store.finish(plan, summary)
        write_files(folder, store, plan, summary)


def make_photographs(folder: Path) -> None:
    """Those of the batch of `make_batch` that can be read."""
    for name in ("a.png", "b.png"):
        cv2.imwrite(str(folder / name), _pixels((10, 8)))


def make_unfinished_batch(folder: Path) -> Plan:
    """A batch that has matched all pairs and has no result."""
    names = ("a.png", "b.png", "c.png")
    K = np.array([[9.0, 0, 4], [0, 9, 3], [0, 0, 1]])
    cameras = {
        "a.png": Camera(K, (10, 8), focal_std=0.4, focal_source="size"),
        "b.png": Camera(K, (10, 8), Distortion("OPENCV", (0.1, 0.0, 0.0, 0.0))),
    }
    states = {name: (100, 10**18) for name in names}
    settings = {"runtime": "auto"}
    indices = np.array([[0, 1], [1, 2]])
    plan = Plan(folder, cameras, {"c.png": "too small"}, states, names, indices, settings)
    t, kept = np.array([1.0, 0, 0]), np.ones(8, bool)
    pose = RelativePose(
        *("ok", "a pose", kept, 8, np.eye(3), t),  # type: ignore[arg-type]
        camera1=cameras["a.png"],
        camera2=cameras["b.png"],
        camera_covariance=np.eye(12),
        alternatives=(Hypothesis(np.eye(3), t[::-1], kept, np.zeros(0, bool), probability=0.25),),
    )
    points = np.random.default_rng(8).uniform(0, 7, (8, 2))
    matches = Matches(points, points + 1, np.ones(8), 0.5)
    good = MatchedPair(row_of(names[:2], pose, 0.5), matches, matches)
    bad = {"c.png": "too small"}
    pairs = [good, MatchedPair(PairRow(*names[1:], BAD_INPUT, "small", bad_images=bad, index=1))]
    with open_store(folder, create=True) as store:
        store.begin(plan)
        with store.change():
            store.add("matched", pairs)
    return plan


def _read_store(folder: Path, path: Path) -> None:
    with open_store(folder) as store:
        assert store.plan is None or store.plan.names
        list(store.pairs("matched"))


READERS: dict[str, tuple[Make, Read]] = {
    "images": (_make_images, _read_image),
    "cameras of images": (_make_images, lambda _, path: auto_camera(image_header(path))),
    "cameras": (_make_cameras, _read_camera),
    "calibrations": (_make_calibrations, _read_calibration),
    "databases": (_make_database, lambda _, path: read_database(path)),
    "pair lists": (_make_pair_list, lambda _, path: read_pairs(path)),
    "batch lists": (_make_batch_lists, lambda _, path: read_pair_list(path)),
    "weights": (_make_weights, lambda _, path: load_network(path)),
    "matches": (_make_matches, _read_matches),
    "batches": (make_batch, lambda folder, _: pair_geometries(read_batch(folder))),
    "unfinished batches": (make_unfinished_batch, _read_store),
}
