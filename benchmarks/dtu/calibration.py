"""DTU's calibrated camera positions."""

from dataclasses import dataclass
from pathlib import Path

import numpy as np

from dgc_pose.files.inputs import read_as, read_text

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
