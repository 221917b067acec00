"""DTU's calibrated camera positions, from the matrices that each layout holds."""

from dataclasses import dataclass
from pathlib import Path

import numpy as np

from dgc_pose.errors import InputError
from dgc_pose.files.inputs import read_text

_BYTES = 2**16  # of a file with a few matrices
ROTATION_TOLERANCE = 1e-3  # largest difference that rounding in a file may leave


@dataclass(frozen=True, eq=False)
class DtuView:
    """A calibrated camera position: X_cam = R X_world + t."""

    K: np.ndarray  # (3, 3) pixels, (0, 0) the centre of the top-left pixel, diagonal > 0
    R: np.ndarray  # (3, 3) rotation, cam_from_world
    t: np.ndarray  # (3,) millimetres, cam_from_world


def read_projection(path: Path) -> DtuView:
    """Read one `pos_NNN.txt`: the 3x4 matrix P, world (mm) to pixel.

    Raises InputError, with the path, unless the file holds 12 finite numbers that are a camera;
    OSError if it cannot be read.
    """
    text = read_text(path, "a calibration", _BYTES)
    try:
        P = np.array(text.split(), np.float64).reshape(3, 4)
    except ValueError:
        raise InputError(f"{path}: expected 3 rows of 4 numbers") from None
    return decompose(P, str(path))


def read_cam(path: Path) -> DtuView:
    """Read one of MVSNet's `NNNNNNNN_cam.txt`: the word `extrinsic`, 4x4 (world, mm, to camera),
    the word `intrinsic`, 3x3, and depths, which are not read.

    Raises InputError, with the path, if the file is malformed or its matrices are no camera;
    OSError if it cannot be read.
    """
    words = read_text(path, "a calibration", _BYTES).split()
    try:
        if words[0] != "extrinsic" or words[17] != "intrinsic":
            raise ValueError
        extrinsic = np.array(words[1:17], np.float64).reshape(4, 4)
        K = np.array(words[18:27], np.float64).reshape(3, 3)
    except (IndexError, ValueError):
        raise InputError(
            f"{path}: expected the word extrinsic, 4 rows of 4 numbers, "
            "the word intrinsic, 3 rows of 3 numbers"
        ) from None
    # Through P, as in the other layouts: the same matrices give the same view to the bit.
    with np.errstate(over="ignore", invalid="ignore"):  # not finite: `decompose` raises
        P = K @ extrinsic[:3]
    view = decompose(P, str(path))
    if not np.allclose(view.R, extrinsic[:3, :3], atol=ROTATION_TOLERANCE):
        raise InputError(
            f"{path}: the matrices are no camera: the extrinsic 3x3 must be a rotation and the "
            "intrinsic one upper triangular with a positive diagonal"
        )
    return view


def decompose(P: np.ndarray, name: str) -> DtuView:
    """Split P ~ K [R | t] by RQ, with diag(K) > 0, K[2, 2] = 1 and det(R) = +1.

    P (3, 4) may carry any scale but zero, its sign included. Raises InputError, naming `name`,
    if its numbers are not finite or its left 3x3 is singular.
    """
    if not np.isfinite(P).all():
        raise InputError(f"{name}: the numbers must be finite")
    if not np.linalg.cond(P[:, :3]) < 1e12:
        raise InputError(f"{name}: the matrix is no camera: its left 3x3 is singular")
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
