"""DTU on a user's disk, as its authors ship it: `Calibration/cal18/pos_NNN.txt`, and `Rectified` or
`Cleaned/scanN`; the sample set has all of it in a folder `MVS Data`.
"""

import re
from collections.abc import Callable, Mapping
from dataclasses import dataclass
from functools import cache
from pathlib import Path
from typing import Literal

import numpy as np

from dgc_pose.cameras.by_image import checked_camera
from dgc_pose.cameras.camera import Camera
from dgc_pose.errors import InputError
from dgc_pose.images.decoding import image_size
from dgc_pose.system.files import read_as, read_text

Light = Literal["0", "1", "2", "3", "4", "5", "6", "max"]  # as in the names of images
_EXPECTED = "Calibration/cal18/pos_001.txt and Rectified/scan1/rect_001_3_r5000.png"
_BYTES = 2**16  # of a file with a few matrices


@dataclass(frozen=True, eq=False)
class DtuView:
    """A calibrated camera position: X_cam = R X_world + t."""

    K: np.ndarray  # (3, 3) pixels, (0, 0) the centre of the top-left pixel, diagonal > 0
    R: np.ndarray  # (3, 3) rotation, cam_from_world
    t: np.ndarray  # (3,) millimetres, cam_from_world


def read_projection(path: Path) -> DtuView:
    """Read one `pos_NNN.txt`: the 3x4 matrix P, world (mm) to pixel, of any scale but zero.

    P ~ K [R | t] is split by RQ, with diag(K) > 0, K[2, 2] = 1 and det(R) = +1. Raises InputError,
    with the path, unless the file holds 12 finite numbers that are a camera; OSError if it cannot
    be read.
    """
    with read_as("a calibration", path):
        P = np.array(read_text(path, "a calibration", _BYTES).split(), np.float64).reshape(3, 4)
        if not (np.isfinite(P).all() and np.linalg.cond(P[:, :3]) < 1e12):
            raise ValueError("the left 3x3 of a camera has finite numbers and an inverse")
    if np.linalg.det(P[:, :3]) < 0:
        P = -P
    # Of the rows and the columns in reverse order RQ is QR.
    q, r = np.linalg.qr(P[::-1, :3].T)
    upper, R = r.T[::-1, ::-1], q.T[::-1]
    signs = np.sign(np.diag(upper))
    upper, R = upper * signs, signs[:, None] * R
    return DtuView(K=upper / upper[2, 2], R=R, t=np.linalg.solve(upper, P[:, 3]))


def relative_pose(view1: DtuView, view2: DtuView) -> tuple[np.ndarray, np.ndarray]:
    """cam2_from_cam1 as R (3, 3) and t (3,) in millimetres: R2 R1^T and t2 - R t1."""
    R = view2.R @ view1.R.T
    return R, view2.t - R @ view1.t


@dataclass(frozen=True)
class DtuScene:
    """The views of a scene that have both an image and a calibration."""

    number: int
    views: Mapping[int, DtuView]  # by DTU's position, from 1; in pixels of `size`
    images: Mapping[int, Path]  # by position
    size: tuple[int, int]  # (width, height) of every image; (0, 0) without any

    @property
    def missing(self) -> int:
        """How many of DTU's positions lack an image or a calibration."""
        return _positions(self.number) - len(self.views)


def open_dataset(
    root: str | Path, scan: int | None = None, light: Light = "3"
) -> tuple[Path, list[DtuScene]]:
    """The folder that names of images are relative to, and the scenes, or the one of that number.

    Raises InputError, with the path, if no scene has two views, or if a calibration is malformed;
    ImageError for a file that is no image; OSError.
    """
    root = Path(root)
    if (root / "MVS Data/Calibration/cal18").is_dir():
        root = root / "MVS Data"
    folders = [path for kind in ("Rectified", "Cleaned") for path in (root / kind).glob("scan*")]
    matches = (re.fullmatch(r"scan(\d+)", path.name) for path in folders)
    numbers = {int(match[1]) for match in matches if match} if scan is None else {scan}
    read = cache(read_projection)  # scenes share the calibration
    scenes = [_read_scene(root, number, light, read) for number in sorted(numbers)]
    scenes = [scene for scene in scenes if len(scene.views) > 1]
    if not scenes:
        which = "a scan" if scan is None else f"scan{scan}"
        raise InputError(
            f"{root}: {which} with two views, of light {light} and with a calibration, is not "
            f"there, such as {_EXPECTED}"
        )
    return root, scenes


def _positions(scene: int) -> int:
    """How many positions DTU took a scene from."""
    return 49 if scene <= 77 else 64


def _read_scene(root: Path, number: int, light: Light, read: Callable[[Path], DtuView]) -> DtuScene:
    """Find the views of a scene; those without an image or a calibration are left out.

    Raises InputError, with the path, for a calibration that is malformed or cannot belong to the
    image, and if images differ in size; ImageError for a file that is no image.
    """
    views: dict[int, DtuView] = {}
    images: dict[int, Path] = {}
    size: tuple[int, int] | None = None
    folder, start = root / "Rectified" / f"scan{number}", "rect"
    if not folder.is_dir():
        folder, start = root / "Cleaned" / f"scan{number}", "clean"
    ending = light if light == "max" else f"{light}_r5000"
    for position in range(1, _positions(number) + 1):
        calibration = root / f"Calibration/cal18/pos_{position:03d}.txt"
        stem = f"{start}_{position:03d}_{ending}"
        paths = (folder / f"{stem}{suffix}" for suffix in (".png", ".jpg"))
        image = next((path for path in paths if path.is_file()), None)
        if image is None or not calibration.is_file():
            continue
        view, actual = read(calibration), image_size(image)
        size = size or actual
        if actual != size:
            raise InputError(
                f"{image}: expected {size[0]} x {size[1]} pixels, found {actual[0]} x {actual[1]}"
            )
        # Its warning about the principal point is for cameras that a user gives.
        checked_camera(Camera(view.K), size, f"K of {image}")
        views[position], images[position] = view, image
    return DtuScene(number, views, images, size or (0, 0))
