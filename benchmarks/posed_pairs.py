"""Pairs of images with cameras and the true pose, to evaluate poses; the pairs of DTU."""

from __future__ import annotations

import re
from collections.abc import Sequence
from dataclasses import dataclass, replace
from functools import cache, partial
from pathlib import Path
from typing import Literal

import numpy as np

from dgc_pose.cameras.by_image import checked_camera
from dgc_pose.cameras.camera import Camera
from dgc_pose.cameras.pair_list import Pair
from dgc_pose.errors import ImageError, InputError
from dgc_pose.geometry.pixels import exif_turn
from dgc_pose.images.cache import ImageCache
from dgc_pose.images.image import Image
from dgc_pose.system.files import read_as, read_text

Light = Literal["0", "1", "2", "3", "4", "5", "6", "max"]  # as in DTU's file names
# Each line has two of DTU's positions, from 1: all pairs whose views differ by a rotation of 5 to
# 40 degrees and share 0.4 of the space at the object, in random order, spread over the rotations.
# Each of DTU's scans has these 49 positions, with one calibration.
_VIEWS = Path(__file__).with_name("dtu_views.txt")
_FIRST_SCAN, _STEP = 65, 24  # scan 65 begins with the first line, each next scan 24 lines later
_EXPECTED = "Calibration/cal18/pos_001.txt and Rectified/scan1/rect_001_3_r5000.png"


@dataclass(frozen=True, eq=False)
class PosedPair:
    """Two images, their cameras and the true pose: x2 = R x1 + t."""

    image1: Image
    image2: Image
    camera1: Camera  # of the image as the methods get it
    camera2: Camera
    R: np.ndarray | None  # (3, 3); None for images of two scenes
    t: np.ndarray | None  # (3,), any length; also None for a pure rotation


class ListedPairs:
    """Pairs of image files. A cache keeps images that were read recently."""

    def __init__(self, pairs: Sequence[Pair], *, size: tuple[int, int] | None = None) -> None:
        """size: (width, height) to resize the images to; None keeps their size.

        Raises ImageError, with the path, if any image is missing.
        """
        for pair in pairs:
            for path in (pair.path1, pair.path2):
                if not path.is_file():
                    raise ImageError(f"{path}: no such image; it is named in the pair list")
        self.pairs, self._size, self._images = pairs, size, ImageCache(2**29)

    def pair(self, number: int) -> PosedPair:
        """A pair by its number.

        Raises ImageError if an image cannot be read, InputError if a camera does not fit its image.
        """
        pair = self.pairs[number]
        image1, camera1, turn1 = self._shown(pair.path1, pair.camera1)
        image2, camera2, turn2 = self._shown(pair.path2, pair.camera2)
        R, t = turn2 @ pair.R @ turn1.T, turn2 @ pair.t
        return PosedPair(image1, image2, camera1, camera2, R, t)

    def _shown(self, path: Path, camera: Camera) -> tuple[Image, Camera, np.ndarray]:
        """An upright image, its camera, and the rotation (3, 3) to its axes from the axes of the
        list, which describes the stored pixels."""
        image, turn = self._images.read(Path(), str(path), size=self._size), np.eye(3)
        full = image.stored_size or image.size
        turn[:2, :2] = exif_turn(image.exif.orientation)
        stored = full if turn[0, 0] else full[::-1]
        checked_camera(camera, stored, f"K of {image.name}")
        if image.exif.orientation != 1:
            camera = camera.turned(turn[:2, :2], stored)
        if self._size is not None:
            camera = replace(camera, size=full).resized(self._size)
        return image, camera, turn


def dtu_pairs(root: Path, scan: int | None, light: Light, count: int) -> list[Pair]:
    """`count` pairs, t in millimetres, spread evenly over the scans below the root, or of one scan.

    root: contains `Calibration/cal18/pos_NNN.txt` and `Rectified` or `Cleaned/scanN`, in the sample
    set within a folder `MVS Data`. Pairs without an image or a calibration are skipped: there may
    be fewer. Raises InputError, with the path, without pairs or if a calibration is malformed.
    """
    root = root / "MVS Data" if (root / "MVS Data/Calibration").is_dir() else root
    folders = [path for kind in ("Rectified", "Cleaned") for path in (root / kind).glob("scan*")]
    matches = (re.fullmatch(r"scan(\d+)", path.name) for path in folders)
    scans = {int(match[1]) for match in matches if match} if scan is None else {scan}
    lines = [[int(word) for word in line.split()] for line in _VIEWS.read_text().splitlines()]
    listed = []
    for number in scans:
        find = cache(partial(_view_files, root, number, light))
        for rank in range(len(lines)):
            position1, position2 = lines[(rank + _STEP * (number - _FIRST_SCAN)) % len(lines)]
            view1, view2 = find(position1), find(position2)
            if view1 is not None and view2 is not None:
                listed.append((rank, number, view1, view2))
    # The first pairs of each scan, so that all scans have as many; then scan by scan.
    chosen = sorted(listed, key=lambda entry: entry[:2])[:count]
    if not chosen:
        which = "a scan" if scan is None else f"scan{scan}"
        raise InputError(
            f"{root}: two views of {which}, of light {light} and with a calibration, are not "
            f"there, such as {_EXPECTED}"
        )
    read = cache(read_projection)
    pairs = []
    for _, _, view1, view2 in sorted(chosen, key=lambda entry: (entry[1], entry[0])):
        name1, name2 = (image.relative_to(root).as_posix() for image, _ in (view1, view2))
        (K1, R1, t1), (K2, R2, t2) = (read(calibration) for _, calibration in (view1, view2))
        R = R2 @ R1.T
        pairs.append(Pair(name1, name2, root, Camera(K1), Camera(K2), R, t2 - R @ t1))
    return pairs


def _view_files(root: Path, scan: int, light: Light, position: int) -> tuple[Path, Path] | None:
    """The image of a view and its calibration; None if either is missing."""
    folder, start = root / "Rectified" / f"scan{scan}", "rect"
    if not folder.is_dir():
        folder, start = root / "Cleaned" / f"scan{scan}", "clean"
    stem = f"{start}_{position:03d}_{light if light == 'max' else f'{light}_r5000'}"
    calibration = root / f"Calibration/cal18/pos_{position:03d}.txt"
    for image in (folder / f"{stem}.png", folder / f"{stem}.jpg"):
        if image.is_file() and calibration.is_file():
            return image, calibration
    return None


def read_projection(path: Path) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """K (3, 3), R (3, 3) and t (3,) of cam_from_world from a file `pos_NNN.txt`, which contains
    P (3, 4), world (mm) to pixel, of any scale but zero.

    RQ splits P ~ K [R | t], with diag(K) > 0, K[2, 2] = 1 and det(R) = +1. Raises InputError, with
    the path, unless the file has 12 finite numbers that form a camera; OSError if it is unreadable.
    """
    with read_as("a calibration", path):
        P = np.array(read_text(path, "a calibration").split(), np.float64).reshape(3, 4)
        if not (np.isfinite(P).all() and np.linalg.cond(P[:, :3]) < 1e12):
            raise ValueError("the left 3x3 of a camera has finite numbers and an inverse")
    if np.linalg.det(P[:, :3]) < 0:
        P = -P
    # RQ is QR of the rows and the columns in reverse order.
    q, r = np.linalg.qr(P[::-1, :3].T)
    upper, R = r.T[::-1, ::-1], q.T[::-1]
    signs = np.sign(np.diag(upper))
    upper, R = upper * signs, signs[:, None] * R
    return upper / upper[2, 2], R, np.linalg.solve(upper, P[:, 3])
