"""The pairs of DTU: those of `views.txt`, with the true poses of DTU's calibration."""

import re
from functools import cache, partial
from pathlib import Path
from typing import Literal

from dgc_pose.benchmarks.dtu.calibration import read_projection
from dgc_pose.cameras.camera import Camera
from dgc_pose.cameras.pair_list import Pair
from dgc_pose.errors import InputError

Light = Literal["0", "1", "2", "3", "4", "5", "6", "max"]  # as in DTU's file names
# Each line has two of DTU's positions, from 1: all pairs whose views differ by a rotation of 5 to
# 40 degrees and share 0.4 of the space at the object, in random order, spread over the rotations.
# Each of DTU's scans has these 49 positions, with one calibration.
_VIEWS = Path(__file__).with_name("views.txt")
_FIRST_SCAN = 65  # begins with the first line
_STEP = 24  # lines after which the next scan begins
_EXPECTED = "Calibration/cal18/pos_001.txt and Rectified/scan1/rect_001_3_r5000.png"


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
            view1 = find(position1)
            view2 = find(position2)
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
    folder = root / "Rectified" / f"scan{scan}"
    start = "rect"
    if not folder.is_dir():
        folder = root / "Cleaned" / f"scan{scan}"
        start = "clean"
    stem = f"{start}_{position:03d}_{light if light == 'max' else f'{light}_r5000'}"
    calibration = root / f"Calibration/cal18/pos_{position:03d}.txt"
    for image in (folder / f"{stem}.png", folder / f"{stem}.jpg"):
        if image.is_file() and calibration.is_file():
            return image, calibration
    return None
