"""A finished DTU run made up for its report: true matches and made-up errors, nothing estimated."""

import json
from dataclasses import dataclass
from itertools import combinations, product
from pathlib import Path

import cv2
import dtu_layout
import numpy as np

from dgc_pose.benchmarks.dtu.calibration import relative_pose
from dgc_pose.benchmarks.dtu.dtu_pairs import DtuPairs, Protocol
from dgc_pose.benchmarks.dtu.view_pairs import ViewPair
from dgc_pose.benchmarks.scores import DtuScore
from dgc_pose.cameras.camera import Camera
from dgc_pose.cameras.pair_list import Pair
from dgc_pose.metrics import rotation_error_deg

METHODS = ("net", "net/all", "points")  # the last one without a map
DEGREES = (-20.0, -12.0, -5.0, 0.0, 8.0, 19.0)
COUNT = 24  # matches of a sample
OUTLIERS = 6


@dataclass(frozen=True)
class FinishedRun:
    """What `write_report` takes."""

    out: Path
    views: list[ViewPair]
    listed: list[Pair]
    rows: list[DtuScore]  # pair after pair, a method each

    def pairs(self, protocol: Protocol = "native") -> DtuPairs:
        return DtuPairs(self.views, self.listed, protocol)


def finished_run(folder: Path) -> FinishedRun:
    """All pairs of six views on an arc; every seventh row is a failure."""
    arc = dtu_layout.arc(DEGREES)
    camera = Camera(dtu_layout.K, dtu_layout.SIZE)
    rng = np.random.default_rng(5)
    for number in arc:
        coarse = rng.integers(0, 256, (12, 16, 3), dtype=np.uint8)
        pixels = cv2.resize(coarse, dtu_layout.SIZE, interpolation=cv2.INTER_CUBIC)
        assert cv2.imwrite(str(folder / f"{number}.png"), pixels)
    views, listed = [], []
    for one, two in combinations(arc, 2):
        R, t = relative_pose(arc[one], arc[two])
        listed.append(Pair(f"{one}.png", f"{two}.png", folder, camera, camera, R, t))
        views.append(ViewPair(65, one, two, 10.0, 0.9 - 0.1 * (two - one), 100.0))
    rows = [
        _row(view, pair, method, rng, success=number % 7 != 3)
        for number, ((view, pair), method) in enumerate(
            product(zip(views, listed, strict=True), METHODS)
        )
    ]
    (folder / "run").mkdir()
    return FinishedRun(folder / "run", views, listed, rows)


def _sample(pair: Pair, rng: np.random.Generator) -> list[list[float]]:
    """Places of points in both views, to a hundredth of a pixel, but for the outliers."""
    width, height = dtu_layout.SIZE
    points1 = (rng.random((COUNT, 2)) * (0.5 * width, 0.5 * height)) + (0.25 * width, 0.25 * height)
    depths = rng.uniform(600, 700, (COUNT, 1))
    places = np.column_stack([points1, np.ones(COUNT)]) @ np.linalg.inv(pair.camera1.K).T * depths
    seen = (places @ pair.R.T + pair.t) @ pair.camera2.K.T
    points2 = seen[:, :2] / seen[:, 2:]
    points2[:OUTLIERS] = rng.random((OUTLIERS, 2)) * (width - 1, height - 1)
    inliers = np.arange(COUNT) >= OUTLIERS
    return np.column_stack([points1.round(2), points2.round(2), inliers]).tolist()


def _row(
    view: ViewPair, pair: Pair, method: str, rng: np.random.Generator, *, success: bool
) -> DtuScore:
    rotation, translation = np.round(rng.gamma(1.5, 6, 2), 4) if success else (np.inf, np.inf)
    return DtuScore(
        method=method,
        scene=view.scene,
        view1=view.view1,
        view2=view.view2,
        image1=pair.name1,
        image2=pair.name2,
        protocol="native",
        true_rotation_deg=round(rotation_error_deg(pair.R, np.eye(3)), 4),
        true_baseline_mm=round(float(np.linalg.norm(pair.t)), 4),
        overlap=view.overlap,
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
        sample=json.dumps(_sample(pair, rng)),
    )
