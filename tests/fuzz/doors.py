"""Every reader of the package, with good files that the tests make themselves.

A door has a folder of good files. The trial damages one of them, calls `read` on the folder, and
puts the good file back.
"""

from __future__ import annotations

import json
import shutil
import struct
from collections.abc import Callable
from contextlib import suppress
from pathlib import Path

import cv2
import dense_scene
import dtu_layout
import numpy as np
import PIL.Image
import pycolmap
import torch
from fuzz import mutators
from fuzz.door import Door
from fuzz.result_doors import RESULT_DOORS

from dgc_pose.batch.calibration import read_calibration
from dgc_pose.benchmarks.dtu.dataset import open_dataset
from dgc_pose.benchmarks.dtu.pair_lists import read_pair_file
from dgc_pose.benchmarks.homographies import find_homography_pairs
from dgc_pose.benchmarks.hpatches_lists import read_lists
from dgc_pose.benchmarks.samples import draw_sample, read_sample, sample_path, write_sample
from dgc_pose.benchmarks.scores import PairScore
from dgc_pose.benchmarks.store import RunStore
from dgc_pose.cameras.camera import guess_camera, parse_camera
from dgc_pose.cameras.colmap_files import read_database
from dgc_pose.cameras.pair_list import read_pair_list, read_pairs
from dgc_pose.images.image import Image, image_size, load_image, read_pixels
from dgc_pose.matches import Matches
from dgc_pose.matching.files import FileMatcher
from dgc_pose.network.config import preset
from dgc_pose.network.net import DGCNet
from dgc_pose.network.weights import load_checkpoint, load_network, save_weights
from dgc_pose.synthesis.photos import load_photos
from dgc_pose.synthesis.posed_depth import read_rgbd
from dgc_pose.synthesis.warp_lists import WarpList

_TEXTS = dict.fromkeys((".txt", ".csv", ".json", ""), mutators.TEXT)
_IMAGES = {
    **dict.fromkeys((".jpg", ".tiff", ".bmp", ".ppm", ".webp", ".gif", ".jp2"), mutators.BYTES),
    **dict.fromkeys((".pgm", ".hdr", ".pfm", ".pam", ".ras", ".avif", ".jpeg"), mutators.BYTES),
    ".heic": mutators.BYTES,
    ".png": mutators.PNG,
}
_K = "300 0 159.5\n0 300 119.5\n0 0 1\n"


def _pixels(size: tuple[int, int] = (40, 30)) -> np.ndarray:
    rng = np.random.default_rng(0)
    return cv2.resize(rng.integers(0, 256, (5, 7, 3), np.uint8), size)


def _make_images(folder: Path) -> None:
    picture = PIL.Image.fromarray(_pixels())
    for ending in ("png", "jpg", "tiff", "bmp", "ppm", "webp", "gif", "jp2", "avif"):
        try:
            picture.save(folder / f"plain.{ending}")
        except (KeyError, OSError, ValueError):  # a Pillow without that format
            continue
    with suppress(ImportError):
        import pillow_heif

        pillow_heif.from_pillow(picture).save(folder / "plain.heic")
    exif = picture.getexif()
    exif[0x0112], exif[0x010F] = 6, "camera"
    picture.save(folder / "turned.jpeg", exif=exif)
    picture.convert("P").save(folder / "palette.png")
    picture.convert("1").save(folder / "bits.png")
    picture.save(folder / "packed.tiff", compression="tiff_lzw")
    deep = _pixels().astype(np.uint16) * 200
    cv2.imwrite(str(folder / "deep.png"), deep)
    cv2.imwrite(str(folder / "deep.tiff"), deep)
    cv2.imwrite(str(folder / "deep.pgm"), deep[:, :, 0])
    floats = _pixels().astype(np.float32) / 255
    cv2.imwrite(str(folder / "floats.tiff"), floats)
    cv2.imwrite(str(folder / "floats.hdr"), floats)
    cv2.imwrite(str(folder / "floats.pfm"), floats)
    cv2.imwrite(str(folder / "planes.pam"), _pixels())
    cv2.imwrite(str(folder / "sun.ras"), _pixels())


def _read_image(folder: Path, path: Path) -> object:
    try:
        image_size(path)
    finally:
        found = load_image(path)
    assert found.pixels.dtype == np.uint8 and found.pixels.shape[2] == 3
    if path.suffix != ".tiff":  # OpenCV makes no colours of floats
        read_pixels(path, cv2.IMREAD_COLOR)
    return found


def _make_guess(folder: Path) -> None:
    picture = PIL.Image.fromarray(_pixels())
    exif = picture.getexif()
    exif.get_ifd(0x8769).update({0x920A: 35.0, 0xA405: 35})
    exif[0x010F], exif[0x0110] = "Canon", "EOS"
    picture.save(folder / "photo.jpeg", exif=exif)
    picture.save(folder / "plain.png")


def _make_cameras(folder: Path) -> None:
    (folder / "K.txt").write_text(_K)
    (folder / "line.txt").write_text(_K.replace("\n", " "))
    np.save(folder / "K.npy", dense_scene.K)


def _make_camera_texts(folder: Path) -> None:
    (folder / "pinhole.txt").write_text("300,300,159.5,119.5")
    (folder / "opencv.txt").write_text("OPENCV,320,240,300,300,160,120,0.1,0.01,0,0")
    (folder / "radial.txt").write_text("SIMPLE_RADIAL,320,240,300,160,120,-0.1")


def _read_camera_text(folder: Path, path: Path) -> object:
    camera = parse_camera(path.read_bytes().decode("utf-8", "surrogateescape"))
    return camera.normalise(np.array([[10.0, 20.0]]))


def _make_pair_lists(folder: Path) -> None:
    dense_scene.write_pair_list(folder, pairs=2)
    for picture in folder.glob("*.png"):
        picture.unlink()


def _make_layout(layout: str) -> Callable[[Path], None]:
    def make(folder: Path) -> None:
        dtu_layout.WRITERS[layout](folder, dtu_layout.grey_scan([-10.0, 0.0, 12.0]))
        (folder / "pairs.csv").write_text("scene,view1,view2\n65,1,2\n65,1,3\n")
        (folder / "poses.txt").write_text("-- id1 id2 scan q t\n1 2 65 1 0 0 0 1 0 0\n")
        names = "scan65/rect_001_3_r5000.png scan65/rect_002_3_r5000.png"
        numbers = " ".join(["300 0 80 0 300 60 0 0 1"] * 2 + ["1 0 0 1 0 1 0 0 0 0 1 0 0 0 0 1"])
        (folder / "glue.txt").write_text(f"{names} 0 0 {numbers}\n")

    return make


def _read_layout(folder: Path, path: Path) -> object:
    dataset = open_dataset(folder)
    if path.parent == folder:
        return read_pair_file(path, dataset)
    return dataset


def _make_weights(folder: Path) -> None:
    torch.manual_seed(0)
    net = DGCNet(preset("dgcm-lite0"))
    save_weights(net, folder / "own.safetensors")
    state = {
        "pyramid.level_0.0.weight": torch.zeros(64, 3, 3, 3),
        "matchability_net.x": torch.ones(3),
    }
    torch.save({"state_dict": state}, folder / "own.pth")
    torch.save(state, folder / "legacy.pth", _use_new_zipfile_serialization=False)


def _make_checkpoints(folder: Path) -> None:
    state = {"preset": "dgcm-lite0", "elapsed": 1.5, "step": 3, "stage": "encoder", "net": {}}
    state["net"]["weight"] = torch.ones(3, 4)
    torch.save(state, folder / "checkpoint.pt")
    torch.save(state, folder / "legacy.pt", _use_new_zipfile_serialization=False)


def _make_stored(folder: Path) -> None:
    flow = np.random.default_rng(0).normal(size=(30, 40, 2)).astype(np.float32)
    for name in ("a.flo", "b.npy", "c.npz", "d.npz", "e.npz", "f.png"):
        (folder / name[0]).mkdir()
    cv2.writeOpticalFlow(str(folder / "a/pair.flo"), flow)
    np.save(folder / "b/pair.npy", flow)
    np.savez(folder / "c/pair.npz", flow=flow, certainty=np.ones((30, 40)))
    grid = np.stack(np.meshgrid(np.arange(40.0), np.arange(30.0)), -1)
    maps = {"map": grid + 1, "grid": grid, "matchability": np.ones((30, 40))}
    np.savez_compressed(folder / "d/pair.npz", **maps)
    points = {"points1": grid.reshape(-1, 2), "points2": grid.reshape(-1, 2), "error_px": 1.0}
    np.savez(folder / "e/pair.npz", **points, confidence=np.ones(1200), key_points=True)
    kitti = np.dstack([np.ones((30, 40)), flow[..., ::-1] * 64 + 2**15]).astype(np.uint16)
    cv2.imwrite(str(folder / "f/pair.png"), kitti)


def _read_stored(folder: Path, path: Path) -> object:
    images = [Image(_pixels(), name) for name in ("one", "two")]
    return FileMatcher(path.parent, lambda *_: "pair").match(images[0], images[1])


_KEYS = [[("sift", "a", "b")], [("sift", "a", "c")]]


def _make_run(folder: Path) -> None:
    RunStore(folder, PairScore, _KEYS, {"batch": 1})
    values = dict.fromkeys(PairScore.tables["results.csv"], "1")
    values |= {"method": "sift", "image1": "a", "image2": "b", "success": "True", "status": "ok"}
    rows = [",".join(PairScore.headings.get(n, n) for n in values), ",".join(values.values())]
    (folder / "results.csv").write_text("\n".join(rows) + "\n")


def _make_sample(folder: Path) -> None:
    points = np.random.default_rng(0).uniform(0, 30, (20, 2))
    matches = Matches(points, points, np.ones(20), error_px=1.0)
    write_sample(folder, ("sift", 1, 2, 3), draw_sample(matches, np.ones(20, bool), 0))
    shutil.copy(sample_path(folder, ("sift", 1, 2, 3)), folder / "copy.json")


def _read_a_sample(folder: Path, path: Path) -> object:
    if path.parent == folder:
        shutil.copy(path, sample_path(folder, ("sift", 1, 2, 3)))
    return read_sample(folder, ("sift", 1, 2, 3))


def _make_homographies(folder: Path) -> None:
    for sequence, names in {"v_wall": ("1.ppm", "2.ppm", "3.ppm")}.items():
        (folder / sequence).mkdir()
        for name in names:
            PIL.Image.fromarray(_pixels()).save(folder / sequence / name)
        for k in (2, 3):
            (folder / sequence / f"H_1_{k}").write_text("1 0 2\n0 1 3\n0 0 1\n")
    header = "obj,im1,im2,Him,Wim,H11,H12,H13,H21,H22,H23,H31,H32,H33\n"
    for k in range(2, 7):
        row = f"v_wall,1,{k},30,40,1,0,2,0,1,3,0,0,1\n"
        (folder / f"hpatches_1_{k}.csv").write_text(header + row)


def _read_homographies(folder: Path, path: Path) -> object:
    return read_lists(folder, folder) if path.suffix == ".csv" else find_homography_pairs(folder)


def _make_warps(folder: Path) -> None:
    names = ",".join(["fname", "aff/tps/homo", *(f"t{k}" for k in range(1, 19))])
    bent = ",".join(["1", "0", "0", "0", "1", "0", *["0"] * 12])
    plane = ",".join(["1", "0", "5", "0", "1", "5", "0", "0", "1", *["0"] * 9])
    (folder / "warps.csv").write_text(f"{names}\na.jpg,0,{bent}\na.jpg,1,{bent}\na.jpg,2,{plane}\n")


def _make_rgbd(folder: Path) -> None:
    (folder / "images").mkdir()
    (folder / "depth").mkdir()
    for k in range(2):
        cv2.imwrite(str(folder / f"images/{k}.png"), _pixels())
        cv2.imwrite(str(folder / f"depth/{k}.png"), np.full((30, 40), 1500, np.uint16))
    (folder / "K.txt").write_text("40 0 19.5\n0 40 14.5\n0 0 1\n")
    (folder / "poses.txt").write_text("1 0 0 0 0 1 0 0 0 0 1 0 0 0 0 1\n" * 2)


def _read_rgbd(folder: Path, path: Path) -> object:
    return [frame.read_depth() for frame in read_rgbd(folder)]


def _make_photos(folder: Path) -> None:
    for k in range(24):
        cv2.imwrite(str(folder / f"{k}.{'jpg' if k % 2 else 'png'}"), _pixels((8, 6)))


def _make_batch_cameras(folder: Path) -> None:
    (folder / "table.csv").write_text("name,fx,fy,cx,cy,width,height\na.png,9,9,4,3,10,8\n")
    frames = [{"file_path": "./a.png", "transform_matrix": np.eye(4).tolist()}]
    nerf = {"fl_x": 9.0, "fl_y": 9.0, "cx": 5, "cy": 4, "w": 10, "h": 8, "frames": frames}
    (folder / "transforms.json").write_text(json.dumps(nerf))
    projection = " ".join(map(str, [9, 0, 4, 0, 0, 9, 3, 0, 0, 0, 1, 0]))
    (folder / "calib.txt").write_text(f"P0: {projection}\nP1: {projection}\n")
    for name in ("text", "binary"):
        (folder / name).mkdir()
    (folder / "text/cameras.txt").write_text("1 OPENCV 10 8 9 9 5 4 0.1 0 0 0\n")
    values = struct.pack("<4d", 9, 9, 5, 4)
    camera = struct.pack("<QIiQQ", 1, 1, 1, 10, 8) + values
    (folder / "binary/cameras.bin").write_bytes(camera)
    for name, ending, content in (
        ("model", "txt", b"1 OPENCV 10 8 9 9 5 4 0.1 0 0 0\n"),
        ("packed", "bin", camera),
    ):
        (folder / name).mkdir()
        (folder / name / f"cameras.{ending}").write_bytes(content)
    (folder / "model/images.txt").write_text("1 1 0 0 0 0 0 0 1 a.png\n2 3 -1\n")
    image = struct.pack("<QI7dI", 1, 1, 1, 0, 0, 0, 0, 0, 0, 1) + b"a.png\0"
    image += struct.pack("<QddQ", 1, 2.0, 3.0, 2**64 - 1)
    (folder / "packed/images.bin").write_bytes(image)


def _read_batch_cameras(folder: Path, path: Path) -> object:
    if path.stem == "images":
        path = path.with_name("cameras" + path.suffix)
    return read_calibration(str(path))


def _make_batch_lists(folder: Path) -> None:
    (folder / "plain.txt").write_text("a.png b.png\n# c\na.png c.png\n")
    (folder / "table.csv").write_text("name1,name2\na.png,b.png\n")
    _make_pair_lists(folder)


def _make_database(folder: Path) -> None:
    with pycolmap.Database.open(folder / "own.db") as database:
        camera = pycolmap.Camera.create_from_model_name(1, "PINHOLE", 9.0, 10, 8)
        camera.has_prior_focal_length = True
        database.write_camera(camera, use_camera_id=True)
        for number in (1, 2):
            image = pycolmap.Image(name=f"{number}.png", camera_id=1, image_id=number)
            database.write_image(image, use_image_id=True)
        database.write_matches(1, 2, np.array([[0, 0], [1, 1]], np.uint32))


DOORS = (
    Door("images", _make_images, _read_image, _IMAGES, 4.0),
    Door("guessed cameras", _make_guess, lambda _, path: guess_camera(path), _IMAGES, 0.5),
    Door(
        "K files",
        _make_cameras,
        lambda _, path: parse_camera(str(path)),
        {".txt": mutators.TEXT, ".npy": mutators.BYTES},
    ),
    Door("camera texts", _make_camera_texts, _read_camera_text, _TEXTS),
    Door("pair lists", _make_pair_lists, lambda _, path: read_pairs(path), _TEXTS),
    Door("DTU raw", _make_layout("raw"), _read_layout, {**_TEXTS, ".png": mutators.PNG}, 0.3),
    Door(
        "DTU MVSNet", _make_layout("mvsnet"), _read_layout, {**_TEXTS, ".jpg": mutators.BYTES}, 0.3
    ),
    Door("DTU NeuS", _make_layout("neus"), _read_layout, {**_TEXTS, ".npz": mutators.ZIP}, 0.3),
    Door(
        "weights",
        _make_weights,
        lambda _, path: load_network(path),
        {".pth": mutators.ZIP, ".safetensors": mutators.BYTES},
        0.3,
    ),
    Door(
        "checkpoints",
        _make_checkpoints,
        lambda _, path: load_checkpoint(path),
        {".pt": mutators.ZIP},
    ),
    Door(
        "stored matches",
        _make_stored,
        _read_stored,
        {
            ".flo": mutators.BYTES,
            ".npy": mutators.BYTES,
            ".npz": mutators.ZIP,
            ".png": mutators.PNG,
        },
        2.0,
    ),
    Door(
        "results",
        _make_run,
        lambda folder, _: RunStore(folder, PairScore, _KEYS, {"batch": 1}, resume=True),
        {".csv": mutators.TEXT, ".json": mutators.JSON},
    ),
    Door("batch lists", _make_batch_lists, lambda _, path: read_pair_list(path), _TEXTS),
    Door(
        "batch cameras",
        _make_batch_cameras,
        _read_batch_cameras,
        {**_TEXTS, ".json": mutators.JSON, ".bin": mutators.BYTES},
    ),
    Door(
        "databases",
        _make_database,
        lambda _, path: read_database(path),
        {".db": mutators.SQL},
        0.3,
    ),
    Door("samples", _make_sample, _read_a_sample, {".json": mutators.JSON}),
    Door("homographies", _make_homographies, _read_homographies, _TEXTS),
    Door("warp lists", _make_warps, lambda _, path: WarpList.read(path), _TEXTS),
    Door("RGB-D folders", _make_rgbd, _read_rgbd, {**_TEXTS, ".png": mutators.PNG}, 0.5),
    Door(
        "photographs",
        _make_photos,
        lambda folder, _: load_photos(folder, 8),
        {".png": mutators.PNG, ".jpg": mutators.BYTES},
        0.2,
    ),
    *RESULT_DOORS,
)
