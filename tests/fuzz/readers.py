"""The readers of files that users have, with good files that the tests make themselves: of each
kind what writes such files into a folder, and what reads one of them."""

from contextlib import suppress

import cv2
import dense_scene
import numpy as np
import PIL.Image
import pycolmap
import torch
from cameras.formats.camera_files import FORMS, write_file
from command_line import run
from given_world import given_world, write_hloc, write_npz, write_with_pycolmap
from PIL.TiffImagePlugin import IFDRational
from worlds import world_scene, write_colmap

from dgc_pose.batch.given import read_given
from dgc_pose.batch.result import read_batch
from dgc_pose.benchmarks.other_matchers import FileMatcher
from dgc_pose.cameras.calibration import parse_camera, read_calibration
from dgc_pose.cameras.formats.colmap import read_database
from dgc_pose.cameras.pair_list import read_pair_list, read_pairs
from dgc_pose.cameras.prior import auto_camera
from dgc_pose.colmap.database import pair_geometries
from dgc_pose.images.decoding import image_header, image_size, read_pixels
from dgc_pose.images.image import Image, load_image
from dgc_pose.matching import MatchingOptions
from dgc_pose.network.config import preset
from dgc_pose.network.net import DGCNet
from dgc_pose.network.weights import load_network
from dgc_pose.training.run import save_weights

PIXELS = cv2.resize(np.random.default_rng(0).integers(0, 256, (5, 7, 3), np.uint8), (40, 30))


def _make_images(folder):
    picture = PIL.Image.fromarray(PIXELS)
    for ending in ("png", "jpg", "tiff", "bmp", "webp", "gif", "jp2", "avif"):
        with suppress(KeyError, OSError, ValueError):  # a Pillow without that format
            picture.save(folder / f"plain.{ending}")
    with suppress(ImportError):
        import pillow_heif

        pillow_heif.from_pillow(picture).save(folder / "plain.heic")
    exif = picture.getexif()
    exif[0x0112] = 6
    exif[0x010F] = "Canon"
    exif[0x0110] = "EOS"
    exif.get_ifd(0x8769).update({0x920A: IFDRational(35, 1), 0xA405: 35, 0xA002: 80, 0xA003: 60})
    picture.save(folder / "turned.jpeg", exif=exif)
    picture.convert("P").save(folder / "palette.png")
    cv2.imwrite(str(folder / "deep.png"), PIXELS.astype(np.uint16) * 200)
    cv2.imwrite(str(folder / "floats.tiff"), PIXELS.astype(np.float32) / 255)


def _camera_of_image(path):
    auto_camera(image_header(path))


def _make_calibrations(folder):
    """Each form in a folder of its own, which may be that of a COLMAP model."""
    for number, (place, content, _) in enumerate(FORMS.values()):
        (folder / f"{number}").mkdir()
        write_file(folder / f"{number}" / place.partition(":")[0], content)
    for name, text in {
        "opencv.arg": "OPENCV,320,240,300,300,160,120,0.1,0.01,0,0",
        "K.txt": "\ufeff300 0 159.5\n0 300 119.5\n0 0 1\n",
        "text/cameras.txt": "1 OPENCV 10 8 9 9 5 4 0.1 0 0 0\n",
        "text/images.txt": "1 1 0 0 0 0 0 0 1 a.png\n2 3 -1\n",
    }.items():
        (folder / name).parent.mkdir(exist_ok=True)
        (folder / name).write_text(text, encoding="utf-8")
    np.save(folder / "K.npy", dense_scene.K)
    write_colmap(world_scene(count=9), folder / "binary")


def _read_calibration(path):
    if path.suffix == ".arg":  # what a user might type
        text = path.read_bytes().decode("utf-8", "surrogateescape")
        parse_camera(text).normalise(np.array([[10.0, 20.0]]))
    else:
        read_calibration(str(path.parent if path.parent.name in ("text", "binary") else path))


def _make_lists(folder):
    """Lists of pairs with their poses and of names, and a COLMAP database."""
    dense_scene.write_pair_list(folder, pairs=2)
    for picture in folder.glob("*.png"):
        picture.unlink()
    (folder / "plain.txt").write_text("a.png b.png\n# c\na.png c.png\n")
    (folder / "table.csv").write_text("name1,name2\na.png,b.png\n")
    with pycolmap.Database.open(folder / "a.db") as database:
        camera = pycolmap.Camera.create_from_model_name(1, "PINHOLE", 9.0, 10, 8)
        camera.has_prior_focal_length = True
        database.write_camera(camera, use_camera_id=True)
        for number in (1, 2):
            image = pycolmap.Image(name=f"{number}.png", camera_id=1, image_id=number)
            database.write_image(image, use_image_id=True)
        database.write_matches(1, 2, np.array([[0, 0], [1, 1]], np.uint32))


def _read_list(path):
    if path.suffix == ".db":
        read_database(path)
    else:
        read_pair_list(path)
        if path.name == "pairs.txt":
            read_pairs(path)


def _make_weights(folder):
    torch.manual_seed(0)
    save_weights(DGCNet(preset("dgcm-lite0")), folder / "a.safetensors")
    torch.save({"x": torch.ones(3)}, folder / "part.pth")


def _make_matches(folder):
    """A file of each format, as `--matches` takes them."""
    flow = np.random.default_rng(0).normal(size=(30, 40, 2)).astype(np.float32)
    cv2.writeOpticalFlow(str(folder / "pair.flo"), flow)
    np.save(folder / "pair.npy", flow)
    np.savez(folder / "flow.npz", flow=flow, matchability=np.ones((30, 40)))
    grid = np.stack(np.meshgrid(np.arange(40.0), np.arange(30.0)), -1)
    points = {"points1": grid.reshape(-1, 2), "points2": grid.reshape(-1, 2), "error_px": 1.0}
    np.savez_compressed(folder / "points.npz", **points, confidence=np.ones(1200), key_points=True)


def _read_matches(path):
    images = [Image(PIXELS, name) for name in ("one", "two")]
    FileMatcher("files", {("one", "two"): path}, MatchingOptions()).match(*images)


def make_batch(folder):
    """A finished batch of three photographs, one of which shows nothing, in folder/batch."""
    (folder / "views").mkdir()
    dense_scene.write_pictures(folder / "views")
    cv2.imwrite(str(folder / "views/void.png"), np.zeros((240, 320), np.uint8))
    words = ("--pairs", "exhaustive", "--weights", "sift", "--K", dense_scene.K_TEXT)
    settings = ("--workers", "1", "--runs", "1", "--iterations", "100")
    done = run("batch", folder / "views", "--out", folder / "batch", *words, *settings)
    assert done.exit_code == 0, done.output


def _make_given(folder):
    """The matches of another program, of each kind."""
    world = given_world(count=2, points=30, unrelated=0)
    for name, write in (("hloc", write_hloc), ("npz", write_npz)):
        write(world, folder / name)
    (folder / "database").mkdir()
    write_with_pycolmap(world, folder / "database/given.db")


def _read_given(path):
    given = read_given(path if path.suffix == ".db" else path.parent)
    for pair in given.places:
        given.read(pair)


READERS = {
    "images": (_make_images, image_size, load_image, read_pixels, _camera_of_image),
    "calibrations": (_make_calibrations, _read_calibration),
    "lists": (_make_lists, _read_list),
    "weights": (_make_weights, load_network),
    "matches": (_make_matches, _read_matches),
    "given": (_make_given, _read_given),
    "batches": (make_batch, lambda path: pair_geometries(read_batch(path.parent))),
}
