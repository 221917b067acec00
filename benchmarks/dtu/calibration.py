"""DTU's calibration: a projection matrix for each position of the camera."""

from pathlib import Path

import numpy as np

from dgc_pose.system.files import read_as, read_text


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
    upper = r.T[::-1, ::-1]
    R = q.T[::-1]
    signs = np.sign(np.diag(upper))
    upper = upper * signs
    R = signs[:, None] * R
    return upper / upper[2, 2], R, np.linalg.solve(upper, P[:, 3])
