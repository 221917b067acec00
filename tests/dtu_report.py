"""A finished DTU run made up for its report: made-up errors, nothing estimated."""

from itertools import combinations, product

import dtu_layout
import numpy as np

from dgc_pose.benchmarks.dtu.calibration import relative_pose
from dgc_pose.benchmarks.scores import DtuScore
from dgc_pose.metrics import rotation_error_deg

METHODS = ("net", "net/all", "points")  # the last one without a map
DEGREES = (-20.0, -12.0, -5.0, 0.0, 8.0, 19.0)


def finished_rows() -> list[DtuScore]:
    """Of all pairs of six views on an arc, pair after pair, a method each; every seventh row is a
    failure."""
    arc = dtu_layout.arc(DEGREES)
    rng = np.random.default_rng(5)
    rows: list[DtuScore] = []
    for (one, two), method in product(combinations(arc, 2), METHODS):
        motion = relative_pose(arc[one], arc[two])
        rows.append(_row((one, two), motion, method, rng, success=len(rows) % 7 != 3))
    return rows


def _row(
    views: tuple[int, int],
    motion: tuple[np.ndarray, np.ndarray],
    method: str,
    rng: np.random.Generator,
    *,
    success: bool,
) -> DtuScore:
    rotation, translation = np.round(rng.gamma(1.5, 6, 2), 4) if success else (np.inf, np.inf)
    return DtuScore(
        method=method,
        scene=65,
        view1=views[0],
        view2=views[1],
        image1=f"{views[0]}.png",
        image2=f"{views[1]}.png",
        protocol="native",
        true_rotation_deg=round(rotation_error_deg(motion[0], np.eye(3)), 4),
        true_baseline_mm=round(float(np.linalg.norm(motion[1])), 4),
        overlap=0.9 - 0.1 * (views[1] - views[0]),
        status="ok" if success else "no_model",
        success=success,
        num_matches=int(rng.integers(100, 2000)),
        num_inliers=int(rng.integers(10, 100)),
        inlier_ratio=0.3,
        rotation_error_deg=float(rotation),
        translation_error_deg=float(translation),
        translation_folded_deg=float(min(translation, 180 - translation) if success else np.inf),
        epipolar_all_px=np.nan if method == "points" else round(rng.gamma(2.0, 3.0), 4),
        epipolar_confident_px=round(rng.gamma(2.0, 1.0), 4),
        epipolar_all_mean_px=np.nan if method == "points" else 5.0,
        epipolar_confident_mean_px=2.0,
        match_seconds=0.2,
        estimate_seconds=round(rng.random(), 4),
    )
