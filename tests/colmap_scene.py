"""Matches of rendered views as a batch would find them: exact ones of the scene's points, noisy,
at fresh places in each pair."""

from itertools import combinations

import numpy as np
from multi_view import SIZE, K

from dgc_pose.batch.rows import PairRow, row_of
from dgc_pose.cameras.camera import Camera
from dgc_pose.colmap.shared import PairGeometry
from dgc_pose.estimation import RelativePose


def camera() -> Camera:
    """Of all views."""
    return Camera(K, SIZE)


def true_row(
    names: tuple[str, str], R: np.ndarray, t: np.ndarray, status: str = "ok", count: int = 100
) -> PairRow:
    """The row of a pair whose pose is known."""
    pose = RelativePose(
        status=status,  # type: ignore[arg-type]
        reason="a pose",
        inliers=np.ones(count, bool),
        num_matches=count,
        R=R,
        t=None if status == "rotation_only" else t / np.linalg.norm(t),
    )
    return row_of(names, pose, 0.5)


def project(points: np.ndarray, R: np.ndarray, t: np.ndarray) -> np.ndarray:
    """Pixels (N, 2) of points (N, 3)."""
    pixels = (points @ R.T + t) @ K.T
    projected: np.ndarray = pixels[:, :2] / pixels[:, 2:]
    return projected


def cloud_pairs(
    poses: list[tuple[np.ndarray, np.ndarray]], *, count: int, noise_px: float, seed: int = 0
) -> list[PairGeometry]:
    """All pairs of cameras, each with matches of the same points and noise of its own."""
    rng = np.random.default_rng(seed)
    points = rng.uniform(-1, 1, (count, 3)) * (1.5, 1.0, 0.8) + (0, 0.1, 4.6)
    seen = [project(points, R, t) for R, t in poses]
    pairs = []
    for i, j in combinations(range(len(poses)), 2):
        (R1, t1), (R2, t2) = poses[i], poses[j]
        R = R2 @ R1.T
        row = true_row((f"view{i}.png", f"view{j}.png"), R, t2 - R @ t1, count=count)
        noisy = [seen[k] + noise_px * rng.standard_normal((count, 2)) for k in (i, j)]
        pairs.append(PairGeometry(row, (camera(), camera()), *noisy, np.linspace(1, 0.5, count)))
    return pairs
