"""A tiny scan in DTU's raw layout: views on an arc around an object, and images of any size."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from pathlib import Path

import cv2
import numpy as np

from dgc_pose.benchmarks.dtu.calibration import View

K = np.array([[2892.0, 0.0, 823.0], [0.0, 2883.0, 619.0], [0.0, 0.0, 1.0]])
DISTANCE = 650.0  # mm from the object that all views look at


def arc(degrees: Sequence[float] | np.ndarray) -> Mapping[int, View]:
    """Views numbered from 1 that look at one point from these angles around it."""
    views = {}
    for number, angle in enumerate(np.radians(degrees), start=1):
        c, s = np.cos(angle), np.sin(angle)
        R = np.array([[c, 0.0, -s], [0.0, 1.0, 0.0], [s, 0.0, c]])
        views[number] = View(K, R, np.array([0.0, 0.0, DISTANCE]))
    return views


def write_raw_layout(
    root: Path,
    degrees: Sequence[float],
    extension: str,
    light: int = 3,
    images: Sequence[np.ndarray] | None = None,
) -> Mapping[int, View]:
    """Write calibration and images (grey 4x3 ones by default) of scan 65 under `root`."""
    views = arc(degrees)
    for folder in ("Calibration/cal18", "Rectified/scan65"):
        (root / folder).mkdir(parents=True)
    for number, view in views.items():
        P = view.K @ np.column_stack([view.R, view.t])
        np.savetxt(root / f"Calibration/cal18/pos_{number:03d}.txt", P, fmt="%.9f")
        picture = np.full((3, 4, 3), 128, np.uint8) if images is None else images[number - 1]
        name = f"rect_{number:03d}_{light}_r5000.{extension}"
        cv2.imwrite(str(root / "Rectified/scan65" / name), picture)
    return views
