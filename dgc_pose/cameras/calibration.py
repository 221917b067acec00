"""The one door for K: what a user says of the cameras, as a text, a file or a value.

- `auto`, `auto:shared` or `auto:two`: no K, see `prior.py`;
- `fx,fy,cx,cy`, a COLMAP camera `MODEL,width,height,parameters...`, or a file with a 3x3 matrix;
- COLMAP's `cameras.txt` or `cameras.bin`, or the folder of a model: with `images.txt` or
  `images.bin` beside it a camera for each image, else a single camera for all;
- `.csv` with the columns name, fx, fy, cx, cy, and optionally width, height, focal_std, and camera,
  equal for images of one camera;
- NeRF's `transforms.json`: intrinsics for all or for each frame, with OpenCV's distortion;
- KITTI's `calib.txt`: `P2:` is the camera of images below a folder `image_2` or `image_02`; of
  other images, the first.
"""

import csv
import math
import os
import re
from collections.abc import Mapping
from dataclasses import dataclass, field, replace
from pathlib import Path, PurePosixPath
from typing import Any, Protocol, get_args

import numpy as np

from dgc_pose.cameras.camera import (
    Camera,
    FocalSource,
    checked_camera,
    guess_camera,
    matrix_camera,
)
from dgc_pose.cameras.camera_text import parse_numbers, read_matrix
from dgc_pose.cameras.colmap_camera import Distortion
from dgc_pose.cameras.colmap_files import find_file, read_model_cameras
from dgc_pose.cameras.prior import Photograph, Sharing, auto_camera, auto_cameras
from dgc_pose.errors import InputError, reason, shortened
from dgc_pose.files.inputs import read_as, read_text
from dgc_pose.files.json_files import read_json

_OPENCV = ("k1", "k2", "p1", "p2")  # of transforms.json, in COLMAP's order
_KITTI_LINE = re.compile(r"P(?:_rect_)?(\d+):\s*(.*)")
_KITTI_FOLDER = re.compile(r"image_0*(\d+)")


_AUTO: Mapping[str, Sharing] = {"auto": "files", "auto:shared": "shared", "auto:two": "two"}


class NamedPhotograph(Photograph, Protocol):
    """An `Image`, or what else has its name, size and EXIF block."""

    @property
    def name(self) -> str:
        """The path, or the argument's name."""


@dataclass(frozen=True)
class Calibration:
    """The cameras of images."""

    where: str  # of errors: the option or file that the cameras come from
    by_name: Mapping[str, Camera] = field(default_factory=dict)
    by_folder: Mapping[int, Camera] = field(default_factory=dict)  # KITTI's, by number
    common: Camera | None = None  # of all other images
    # The images have no K. Of "shared" one camera took all; of "two" each has a camera of its own.
    auto: Sharing | None = None
    # Whether an image without a camera gets one guessed from EXIF data or its size.
    guess: bool = False

    def camera(self, root: Path, name: str, image: Photograph) -> Camera:
        """The camera of an image or its header, checked against its size.

        Raises InputError if there is none, or if it is for another size.
        """
        camera = self.named(name) or self._of_folder(root, name) or self.common
        if camera is not None:
            return checked_camera(camera, image.size, f"{self.where}: {name}: K")
        if self.auto is not None:
            camera = auto_camera(image)
            if self.auto == "files":
                return camera
            return replace(camera, identity="shared" if self.auto == "shared" else None)
        if self.guess:
            return guess_camera(root / name)
        if self.by_name:
            raise InputError(f"{self.where} has no camera for {name}")
        raise InputError(f"no camera for {name}: give --K, or --K auto")

    def says_nothing_of(self, name: str) -> bool:
        """Whether an image may take a camera from elsewhere, such as a list of pairs."""
        return self.common is None and self.auto is None and self.named(name) is None

    def named(self, name: str) -> Camera | None:
        """The camera that the file has for an image; transforms.json may leave out the ending."""
        return self.by_name.get(name) or self.by_name.get(str(PurePosixPath(name).with_suffix("")))

    def _of_folder(self, root: Path, name: str) -> Camera | None:
        for part in reversed((root.resolve() / name).parts):
            if match := _KITTI_FOLDER.fullmatch(part):
                return self.by_folder.get(int(match[1]))
        return None


def camera_for(value: Camera | Any | None, image: NamedPhotograph, name: str) -> Camera:
    """The camera of an image, from a Camera, an array (3, 3), or a text or path as of --K.

    None is "auto". A value without an identity gets that of its argument. Raises InputError, naming
    the argument `name`, if K is unusable or does not fit the image.
    """
    value = "auto" if value is None else value
    if isinstance(value, (str, Path)):
        camera = read_calibration(str(value), name).camera(Path(), image.name, image)
    else:
        camera = value if isinstance(value, Camera) else matrix_camera(value, name)
        camera = replace(camera, identity=camera.identity or name)
        camera = checked_camera(camera, image.size, name)
    return camera


def pair_cameras(
    K1: Camera | Any | None,
    K2: Camera | Any | None,
    image1: NamedPhotograph,
    image2: NamedPhotograph,
    names: tuple[str, str] = ("K1", "K2"),
) -> tuple[Camera, Camera]:
    """The cameras of two images by `camera_for`; without K for both, by `auto_cameras`.

    names: of the arguments. Raises as `camera_for` does.
    """
    K1, K2 = ("auto" if value is None else value for value in (K1, K2))
    sharing1, sharing2 = (
        _sharing(value, name) if isinstance(value, str) else None
        for value, name in zip((K1, K2), names, strict=True)
    )
    if sharing1 is not None and sharing2 is not None:
        if sharing1 != sharing2:
            raise InputError(f"{names[0]} is {K1}, and {names[1]} is {K2}")
        return auto_cameras(image1, image2, sharing1)
    return camera_for(K1, image1, names[0]), camera_for(K2, image2, names[1])


def parse_camera(text: str, name: str = "K", *, files: bool = True) -> Camera:
    """A camera from a text, as on the command line.

    The text is 'fx,fy,cx,cy' in pixels, (0, 0) the centre of the top-left pixel; or the path of a
    text or .npy file with a 3x3 matrix; or a COLMAP camera 'MODEL,width,height,parameters...' with
    COLMAP's principal point, half a pixel more than ours. files: whether the text may be a path;
    False for a stranger's text. Raises InputError of one line, naming `name`.
    """
    if not files:
        return parse_numbers(text, name)
    calibration = read_calibration(text, name)
    if calibration.common is None:
        raise InputError(f"{name}: {text} has no camera for all images")
    return calibration.common


def read_calibration(text: str | None, name: str = "--K", *, guess: bool = False) -> Calibration:
    """The calibration of the option --K: a text or the path of a file, see this module.

    None: no camera for any image. Raises InputError, with the option `name` or the path, if the
    text is none of these or the file is malformed.
    """
    if text is None:
        return Calibration(name, guess=guess)
    if (sharing := _sharing(text, name)) is not None:
        return Calibration(name, auto=sharing)
    if not os.path.lexists(text):
        return Calibration(name, common=replace(parse_numbers(text, name), identity=name))
    path = Path(text)
    try:
        return _read_file(path, name) or Calibration(
            name, common=replace(read_matrix(path, name), identity=name)
        )
    except OSError as error:
        raise InputError(f"{name}: {error.filename or path}: {error.strerror or error}") from error


def _sharing(text: str, name: str) -> Sharing | None:
    """What a word says of a camera without K; None for another text."""
    if text.startswith("auto:") and text not in _AUTO:
        raise InputError(f"{name} must be one of {', '.join(_AUTO)}, not {shortened(text)!r}")
    return _AUTO.get(text)


def _read_file(path: Path, name: str) -> Calibration | None:
    """The cameras of a file or a folder; None for any other file, such as one of a matrix."""
    if path.is_dir():
        model = find_file(path, "cameras.bin") or find_file(path, "cameras.txt")
        if model is None:
            raise InputError(f"{name}: {path} holds no cameras.txt and no cameras.bin")
        return _colmap(model)
    if path.name.lower() in ("cameras.txt", "cameras.bin"):
        return _colmap(path)
    if path.suffix.lower() == ".csv":
        return Calibration(str(path), _csv_cameras(path))
    if path.suffix.lower() == ".json":
        return _transforms(path)
    if by_folder := _kitti_cameras(path):
        return Calibration(str(path), by_folder=by_folder, common=next(iter(by_folder.values())))
    return None


def _colmap(path: Path) -> Calibration:
    cameras, by_image = read_model_cameras(path)
    if by_image:
        by_name = {name: cameras[key] for name, key in by_image.items() if key in cameras}
        return Calibration(str(path), by_name)
    if len(cameras) != 1:
        raise InputError(
            f"{path}: {len(cameras)} cameras, and no images.txt or images.bin beside it to say "
            "which is whose"
        )
    return Calibration(str(path), common=next(iter(cameras.values())))


def _csv_cameras(path: Path) -> dict[str, Camera]:
    lines = read_text(path, "a table of cameras").splitlines()
    with read_as("a table of cameras", path):
        rows = list(csv.DictReader(lines))
    cameras = {}
    for number, row in enumerate(rows, start=2):
        try:
            size = (int(row["width"]), int(row["height"])) if row.get("width") else None
            K = _matrix(*(float(row[key]) for key in ("fx", "fy", "cx", "cy")))
            std, identity = float(row.get("focal_std") or 0), row.get("camera") or None
            cameras[row["name"]] = Camera(K, size, focal_std=std, identity=identity)
        except (KeyError, TypeError, ValueError, OverflowError) as error:
            raise InputError(
                f"{path}:{number}: expected the columns name,fx,fy,cx,cy[,width,height] "
                f"({reason(error)})"
            ) from None
    if not cameras:
        raise InputError(f"{path}: no cameras in this table")
    return cameras


def _transforms(path: Path) -> Calibration:
    data = read_json(path, "a transforms.json")
    try:
        common = _nerf_camera(data)
        by_name = {}
        for frame in data["frames"]:
            if (camera := _nerf_camera({**data, **frame})) is not None:
                by_name.update(dict.fromkeys(_nerf_names(frame["file_path"]), camera))
    except (KeyError, TypeError, AttributeError, ValueError, OverflowError) as error:
        raise InputError(f"{path}: not a transforms.json ({reason(error)})") from None
    if common is None and not by_name:
        raise InputError(f"{path}: no focal length in this transforms.json")
    return Calibration(str(path), by_name, common=common)


def _nerf_camera(data: Mapping[str, Any]) -> Camera | None:
    """Intrinsics of a file or frame; the principal point has (0, 0) at the pixel's corner."""
    width, height = data.get("w"), data.get("h")
    size = None if width is None or height is None else (int(width), int(height))
    fx = data.get("fl_x")
    if fx is None and size is not None and "camera_angle_x" in data:
        fx = size[0] / 2 / math.tan(float(data["camera_angle_x"]) / 2)
    if fx is None:
        return None
    if size is None and not ("cx" in data and "cy" in data):
        raise ValueError("neither cx and cy nor w and h")
    middle = (size[0] / 2, size[1] / 2) if size else (0, 0)
    cx, cy = (float(data.get(key, middle[axis])) - 0.5 for axis, key in enumerate(("cx", "cy")))
    lens = tuple(float(data.get(key, 0)) for key in _OPENCV)
    distortion = Distortion("OPENCV", lens) if any(lens) else None
    return Camera(_matrix(float(fx), float(data.get("fl_y", fx)), cx, cy), size, distortion)


def _nerf_names(file_path: str) -> set[str]:
    """The names that an image of transforms.json may have in a folder: relative to the file, or
    without its folder."""
    path = PurePosixPath(file_path)
    return {path.as_posix(), path.name, PurePosixPath(*path.parts[1:]).as_posix()}


def _kitti_cameras(path: Path) -> dict[int, Camera]:
    """The cameras of a KITTI file by number; none if it is another file."""
    try:
        lines = read_text(path).splitlines()
    except (InputError, OSError):
        return {}
    cameras = {}
    for number, line in enumerate(lines, start=1):
        if match := _KITTI_LINE.fullmatch(line.strip()):
            try:
                P = np.array(match[2].split(), dtype=np.float64).reshape(3, 4)
                cameras[int(match[1])] = Camera(P[:, :3])
            except ValueError as error:
                raise InputError(f"{path}:{number}: not a 3x4 projection ({error})") from None
    return cameras


def _matrix(fx: float, fy: float, cx: float, cy: float) -> np.ndarray:
    return np.array([[fx, 0, cx], [0, fy, cy], [0, 0, 1]])


def camera_data(camera: Camera) -> dict[str, Any]:
    """A camera for JSON."""
    lens = camera.distortion
    return {
        "K": camera.K.tolist(),
        "size": camera.size,
        "model": None if lens is None else lens.model,
        "coefficients": None if lens is None else lens.coefficients,
        "warnings": camera.warnings,
        "focal_std": camera.focal_std,
        "centre_std_px": camera.centre_std,
        "focal_source": camera.focal_source,
        "identity": camera.identity,
        "guessed_focal": camera.guessed_focal,
    }


def parse_camera_data(data: Mapping[str, Any]) -> Camera:
    """The camera of `camera_data`."""
    lens = None
    if data["model"] is not None:
        lens = Distortion(data["model"], tuple(data["coefficients"]))
    if data["focal_source"] not in get_args(FocalSource):
        raise ValueError("a focal_source that is none")
    return Camera(
        np.array(data["K"]),
        None if data["size"] is None else (int(data["size"][0]), int(data["size"][1])),
        lens,
        tuple(data["warnings"]),
        float(data["focal_std"]),
        float(data["centre_std_px"]),
        data["focal_source"],
        data["identity"],
        bool(data["guessed_focal"]),
    )
