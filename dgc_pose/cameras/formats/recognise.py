"""The formats of a file of cameras: one table, by whose readers a file is recognised.

The content decides and, if it is ambiguous, the ending. Files with images have cameras by image
name, files of a rig by camera name. docs/cameras.md and the help of --K show the table.
"""

from collections.abc import Callable, Mapping, Sequence
from dataclasses import replace
from pathlib import Path
from typing import NamedTuple

from dgc_pose.cameras.by_image import Calibration
from dgc_pose.cameras.formats import colmap, keyed, kitti, nerf, rigs
from dgc_pose.cameras.formats.opened import CameraFile
from dgc_pose.errors import InputError, shortened
from dgc_pose.system.files import read_as


class Format(NamedTuple):
    """A row of the table."""

    name: str  # in the help of --K; "" if it is left out
    files: str  # in the documentation, with an example
    example: str
    read: Callable[[CameraFile], Calibration | None]  # None for a file of another format
    # Whether the centre of the top-left pixel is (0.5, 0.5), so that `read` subtracts 0.5. In
    # `Camera`, and in all other files, it is (0, 0).
    half_pixel: bool = False


def read_file(path: Path) -> Calibration:
    """Read the cameras of a file, or of the folder of a COLMAP model.

    Raises InputError, with the path; OSError if a file cannot be read.
    """
    try:
        with read_as("a file of cameras", path):
            return replace(_read(CameraFile(path)), where=str(path))
    except InputError as error:
        if error.path is not None:
            raise
        raise InputError(f"{path}: {error}") from error


def _read(file: CameraFile) -> Calibration:
    for read in dict.fromkeys(row.read for row in FORMATS):
        calibration = read(file)
        if calibration is not None:
            return calibration
    raise InputError(
        "no 3x3 matrix, no fx fy cx cy, and no other file of cameras "
        f"(it begins with {shortened(file.lines[0].strip())!r})"
    )


def _named_toml(file: CameraFile) -> Calibration | None:
    """The cameras of the TOML that a rig.json names."""
    is_rig = isinstance(file.data, Mapping) and file.data.get("calibration") == rigs.CALIBRATION
    return _read(CameraFile(file.path.with_name(rigs.CALIBRATION))) if is_rig else None


# The first reader that gives cameras counts. `keyed.read` takes any keys, so it follows the others
# that take keys.
FORMATS: Sequence[Format] = (
    Format(
        "COLMAP",
        "a COLMAP model's folder, `cameras.txt` or `cameras.bin`",
        "sparse/0",
        colmap.read,
        half_pixel=True,
    ),
    Format(
        "",
        "COLMAP's `rig_config.json` with camera_params",
        "rig_config.json:cam_1",
        rigs.read_colmap,
        half_pixel=True,
    ),
    Format(
        "NeRF",
        "NeRF's `transforms.json` (instant-ngp, nerfstudio)",
        "transforms.json",
        nerf.read,
        half_pixel=True,
    ),
    Format("", "`rig.json` of `dgc-pose rig`", "rig.json:cam_1", _named_toml),
    Format("Kalibr", "Kalibr's camchain; EuRoC's `sensor.yaml`", "camchain.yaml:cam1", rigs.read),
    Format("", "TOML of anipose, caliscope and Pose2Sim", "camera_array.toml:cam_1", rigs.read),
    Format("", "EasyMocap's `intri.yml`", "intri.yml:01", rigs.read),
    Format("", "OpenCV's stereo pair (M1, D1, M2, D2)", "stereo.yml:M2", rigs.read),
    Format("OpenCV", "OpenCV's `FileStorage`: YAML, XML or JSON", "camera.yml", keyed.read),
    Format(
        "ROS",
        "ROS's camera_info: YAML, or the message as `rostopic echo` prints it",
        "ost.yaml",
        keyed.read,
    ),
    Format(
        "",
        "JSON of Open3D (`intrinsic_matrix`), metadata of Record3D",
        "metadata.json",
        keyed.read,
    ),
    Format(
        "JSON",
        "JSON with K, or fx, fy, cx, cy, and size or width, height, a lens; the JSON of `estimate`",
        "pose.json",
        keyed.read,
    ),
    Format(
        "KITTI",
        "KITTI's `calib.txt` and `calib_cam_to_cam.txt`",
        "calib.txt:image_2",
        kitti.read,
    ),
    Format(
        ".csv",
        "`.csv`: name, fx, fy, cx, cy, optionally width, height, focal_std, camera, a lens",
        "cameras.csv",
        keyed.read_table,
    ),
    Format(
        "3x3 matrix",
        "a text or `.npy`: a 3x3 matrix, a 4x4 one that holds it (ScanNet), or fx fy cx cy",
        "K.txt",
        keyed.read_numbers,
    ),
)
