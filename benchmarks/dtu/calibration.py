"""DTU's calibration in the raw layout: one projection matrix a position, shared by all scans."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path

import numpy as np
import scipy.linalg

from dgc_pose.errors import InputError

IMAGE_SIZE = (1600, 1200)  # width, height of the images that the matrices project to, pixels


@dataclass(frozen=True)
class View:
    """A calibrated camera position: X_cam = R X_world + t."""

    K: np.ndarray  # (3, 3) pixels, (0, 0) the centre of the top-left pixel, diagonal > 0
    R: np.ndarray  # (3, 3) rotation, cam_from_world
    t: np.ndarray  # (3,) millimetres, cam_from_world


def read_view(path: str | Path) -> View:
    """Read one `pos_NNN.txt`: the 3x4 matrix P, world (mm) to pixel.

    Raises:
        InputError: with the path, where the file does not hold 3 rows of 4 finite numbers or the
            matrix is no camera.
        OSError: where the file cannot be read.
    """
    path = Path(path)
    try:
        lines = path.read_text(encoding="utf-8").splitlines()
        rows = [[float(field) for field in line.split()] for line in lines if line.strip()]
    except ValueError:
        raise InputError(f"{path}: expected 3 rows of 4 numbers, found something else") from None
    if [len(row) for row in rows] != [4, 4, 4]:
        counts = " + ".join(str(len(row)) for row in rows) or "none"
        raise InputError(f"{path}: expected 3 rows of 4 numbers, found {counts}")
    P = np.array(rows)
    if not np.isfinite(P).all():
        raise InputError(f"{path}: the numbers must be finite")
    try:
        return decompose(P)
    except InputError as error:
        raise InputError(f"{path}: {error}") from None


def decompose(P: np.ndarray) -> View:
    """Split P ~ K [R | t] by RQ, with diag(K) > 0, K[2, 2] = 1 and det(R) = +1.

    P (3, 4) may carry any scale but zero, its sign included. Raises InputError where its left 3x3
    is singular.
    """
    if np.linalg.cond(P[:, :3]) > 1e12:
        raise InputError("the matrix is no camera: its left 3x3 is singular")
    if np.linalg.det(P[:, :3]) < 0:
        P = -P
    upper, R = scipy.linalg.rq(P[:, :3])
    signs = np.sign(np.diag(upper))
    upper, R = upper * signs, signs[:, None] * R
    return View(K=upper / upper[2, 2], R=R, t=np.linalg.solve(upper, P[:, 3]))


def relative_pose(view1: View, view2: View) -> tuple[np.ndarray, np.ndarray]:
    """cam2_from_cam1 as R (3, 3) and t (3,) in millimetres: R2 R1^T and t2 - R t1."""
    R = view2.R @ view1.R.T
    return R, view2.t - R @ view1.t
