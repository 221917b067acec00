"""Whether a camera that did not move explains matches, where the focal lengths are not known.

A crop or a zoom of image 1, or a camera that turned and zoomed, gives a homography. An essential
matrix explains it as well: that of a plane before a camera that moved.
"""

from typing import NamedTuple

import numpy as np

from dgc_pose.estimation.problem import TwoViewProblem
from dgc_pose.estimation.refine import TRANSFER_LIMIT
from dgc_pose.geometry.homography import fit_homography, fit_similarity, transfer_error

_REACH, _STEP, _FINEST = 1.5, 0.3, 0.005  # of ln f of camera 1: tried first, and at last


class StillCamera(NamedTuple):
    """A camera that did not move."""

    share: float  # of the inliers that it explains
    R: np.ndarray  # (3, 3) its rotation


def still_camera(inliers: TwoViewProblem) -> StillCamera:
    """The camera that did not move and explains most inliers.

    Either image 2 is image 1 scaled, rolled and shifted, or the camera turned about its centre,
    each image with another focal length. inliers: normalised by the cameras as stated, whose
    principal points no fit has moved.
    """
    points, limit = (inliers.points1, inliers.points2), TRANSFER_LIMIT * inliers.threshold
    homographies = [(np.eye(3), np.eye(3))]
    similarity = fit_similarity(*points, limit)
    if similarity is not None:
        roll = similarity / np.hypot(*similarity[:2, 0])
        roll[:, 2] = 0, 0, 1
        homographies.append((similarity, roll))
    H = fit_homography(*points, limit, inliers.seed)
    if H is not None:
        turns = {k: _turn(H, k) for k in np.arange(-_REACH, _REACH + _STEP / 2, _STEP)}
        step = _STEP
        while True:
            best = min(turns, key=lambda k: np.median(transfer_error(*points, turns[k][0])))
            if step < _FINEST:
                break
            step /= 2
            turns = {k: _turn(H, k) for k in (best, best - step, best + step)}
        homographies.append(turns[best])
    return max(
        (
            StillCamera(float((transfer_error(*points, still) < limit).mean()), R)
            for still, R in homographies
        ),
        key=lambda camera: camera.share,
    )


def _turn(H: np.ndarray, log_focal: float) -> tuple[np.ndarray, np.ndarray]:
    """The homography (3, 3) near H of a camera that turns, and its rotation. log_focal: of image 1,
    whose points have focal length 1; that of image 2 follows from H."""
    D1 = np.diag([np.exp(log_focal), np.exp(log_focal), 1.0])
    rows = H @ D1
    lengths = np.linalg.norm(rows, axis=1)
    focal2 = lengths[:2].mean() / lengths[2]
    D2 = np.diag([focal2, focal2, 1.0])
    U, _, Vt = np.linalg.svd(np.linalg.solve(D2, rows))
    R = U @ Vt
    R *= np.linalg.det(R)  # H has no sign
    return D2 @ R @ np.linalg.inv(D1), R
