"""A tiny grey scan of one scene, written as DTU is."""

from collections.abc import Sequence
from pathlib import Path

import cv2
import numpy as np

from dgc_pose.cameras.camera import Camera

SIZE = (160, 120)
# DTU's camera at a tenth of its size.
K = Camera(np.array([[2892.0, 0, 823], [0, 2883, 619], [0, 0, 1]]), (1600, 1200)).resized(SIZE).K
DISTANCE = 650.0  # mm from the object that all views look at


def write_scan(
    root: Path,
    degrees: Sequence[float] | np.ndarray,
    number: int = 65,
    *,
    names: str = "Rectified/scan{scan}/rect_{view:03d}_3_r5000.png",
    size: tuple[int, int] = SIZE,
) -> None:
    """The calibration and the images of views, numbered from 1, that look at one point from these
    angles around it. names: of the images' files."""
    for view, angle in enumerate(np.radians(degrees), start=1):
        c, s = np.cos(angle), np.sin(angle)
        matrix = K @ [[c, 0.0, -s, 0.0], [0.0, 1.0, 0.0, 0.0], [s, 0.0, c, DISTANCE]]
        calibration = root / f"Calibration/cal18/pos_{view:03d}.txt"
        calibration.parent.mkdir(parents=True, exist_ok=True)
        calibration.write_text("\n".join(" ".join(map(repr, row)) for row in matrix.tolist()))
        path = root / names.format(scan=number, view=view)
        path.parent.mkdir(parents=True, exist_ok=True)
        cv2.imwrite(str(path), np.full((size[1], size[0], 3), 128, np.uint8))
