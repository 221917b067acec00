"""A COLMAP model in the formats of other tools: functions that write into an empty folder `out`,
which is moved to `at`."""

import os
import re
from pathlib import Path

import cv2

from dgc_pose.errors import ArgumentName, InputError
from dgc_pose.images.decoding import image_header, read_pixels
from dgc_pose.images.image import size_in_file
from dgc_pose.model import Model, write_points
from dgc_pose.system.colmap_library import pycolmap
from dgc_pose.system.files import require_room, save_text
from dgc_pose.system.texts import write_json

_PERSPECTIVE = {"SIMPLE_PINHOLE", "PINHOLE", "SIMPLE_RADIAL", "RADIAL", "OPENCV"}
_FISHEYE = {"SIMPLE_RADIAL_FISHEYE", "RADIAL_FISHEYE", "OPENCV_FISHEYE"}
_ORIENTATION = re.compile(rb"(\x12\x01\x03\x00\x01\x00{3})[\x02-\x08]")  # a tag of EXIF data
_KEYS = {"f": "fl_x", "fx": "fl_x", "fy": "fl_y", "k": "k1"}  # nerfstudio's of COLMAP's parameters


def nerfstudio(model: pycolmap.Reconstruction, images: Path | None, out: Path, at: Path) -> None:
    """transforms.json, with world_from_cam for the axes right, up, backwards; and points.ply.

    Raises InputError for a lens that nerfstudio does not have, and for fisheyes beside others.
    """
    lenses = {image.camera.model.name for image in model.images.values()}
    if not (lenses <= _PERSPECTIVE or lenses <= _FISHEYE):
        raise InputError(ArgumentName("to"), f"nerfstudio cannot hold {', '.join(sorted(lenses))}")
    frames = []
    for _, image in sorted(model.images.items()):
        camera, pose = image.camera, image.cam_from_world().inverse().matrix() * (1, -1, -1, 1)
        path = image.name
        if images is not None:
            path = os.path.join(os.path.realpath(images, strict=True), path)
            os.stat(path)  # raises OSError if it is not there
            path = os.path.relpath(path, os.path.realpath(at))
        frame = {"file_path": path, "transform_matrix": [*pose.tolist(), [0, 0, 0, 1]]}
        frame |= {"w": camera.width, "h": camera.height, "fl_y": camera.focal_length_y}
        values = zip(camera.params_info.split(", "), camera.params.tolist(), strict=True)
        frames.append(frame | {_KEYS.get(name, name): value for name, value in values})
    cloud = Model.of_colmap(model, Path())
    write_points(out / "points.ply", cloud.points, cloud.colours)
    lens = "OPENCV" if lenses <= _PERSPECTIVE else "OPENCV_FISHEYE"
    data = {"camera_model": lens, "ply_file_path": "points.ply", "frames": frames}
    write_json(out / "transforms.json", data)


def openmvs(model: pycolmap.Reconstruction, images: Path | None, out: Path, at: Path) -> None:
    """images/ without distortion and EXIF turn; sparse/ and sparse/0/, their model.

    Raises InputError without `images`, or for a photograph of another size than its camera or of a
    format that pycolmap does not read; ImageError.
    """
    if images is None:
        raise InputError(ArgumentName("images"), "is needed for openmvs")
    pixels = 0
    for image in model.images.values():  # pycolmap ends the process for another size, a full disk
        if os.path.isabs(image.name) or ".." in Path(image.name).parts:
            raise InputError(ArgumentName("images"), f"does not hold the model's {image.name}")
        width, height = size_in_file(image_header(images / image.name))
        if (width, height) != (image.camera.width, image.camera.height):
            raise InputError(f"{images / image.name}: {width} x {height} is not its camera's size")
        pixels += width * height
    require_room(out / "images", 3 * pixels)
    (out / "sparse" / "0").mkdir(parents=True)
    model.write_binary(out / "sparse")
    pycolmap.undistort_images(out, out / "sparse", images)
    undistorted = pycolmap.Reconstruction(out / "sparse")
    undistorted.write_binary(out / "sparse" / "0")  # for Gaussian splatting
    if all(len(image.name.split()) == 1 for image in model.images.values()):  # as text needs it
        undistorted.write_text(out / "sparse")  # for any InterfaceCOLMAP
    for image in model.images.values():
        path = out / "images" / image.name
        if not path.is_file():
            raise InputError(f"{images / image.name}: pycolmap does not read this photograph")
        header = image_header(path)
        # The turn goes and the pixels stay, which the camera is of.
        if header.exif.orientation != 1 and header.format == "JPEG":
            path.write_bytes(_ORIENTATION.sub(b"\\1\x01", path.read_bytes(), count=1))
        elif header.exif.orientation != 1:  # a PNG
            cv2.imwrite(str(path), read_pixels(path))


def tum(model: pycolmap.Reconstruction, images: Path | None, out: Path, at: Path) -> None:
    """trajectory.txt: a line an image with a time and world_from_cam. The times are the names, if
    all of them are numbers, or else count the images in the order of their names."""
    posed = sorted(model.images.values(), key=lambda image: image.name)
    times = [Path(image.name).stem for image in posed]
    if not all(re.fullmatch(r"[0-9]+(\.[0-9]+)?", time) for time in times):
        times = [str(number) for number in range(len(posed))]
    order = sorted(zip(times, posed, strict=True), key=lambda pair: float(pair[0]))
    poses = [(time, image.cam_from_world().inverse()) for time, image in order]
    rows = [(time, *p.translation.tolist(), *p.rotation.quat.tolist()) for time, p in poses]
    lines = ["# time tx ty tz qx qy qz qw", *(" ".join(map(str, row)) for row in rows)]
    save_text(out / "trajectory.txt", "\n".join(lines) + "\n")


FORMATS = {"nerfstudio": nerfstudio, "openmvs": openmvs, "tum": tum}
