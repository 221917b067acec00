"""Seeded two-view scenes of points, of every kind that the estimator must tell apart."""

from dataclasses import dataclass
from typing import Literal, get_args

import numpy as np
from scipy.spatial.transform import Rotation

from dgc_pose.cameras.camera import Camera
from dgc_pose.estimation.problem import TwoViewProblem
from dgc_pose.matches import Matches

SceneKind = Literal[
    "general", "skew", "orbit", "planar", "rotation_only", "forward", "identical", "random"
]
SCENE_KINDS: tuple[SceneKind, ...] = get_args(SceneKind)

CELLS = (0.05, 0.05)  # sides of a grid cell: a thirtieth of the images' width, normalised
SIZE1, SIZE2 = (1600, 1200), (1280, 960)
K1 = np.array([[1700.0, 0, 810], [0, 1690, 590], [0, 0, 1]])
K2 = np.array([[1100.0, 0, 630], [0, 1110, 490], [0, 0, 1]])


@dataclass(frozen=True)
class TwoViewScene:
    """Matches of two views with all that is true of them. Pixels, (0, 0) the first one's centre."""

    points1: np.ndarray  # (N, 2)
    points2: np.ndarray  # (N, 2)
    K1: np.ndarray  # (3, 3)
    K2: np.ndarray  # (3, 3)
    R: np.ndarray  # (3, 3), x2 = R x1 + t
    t: np.ndarray  # (3,) unit length; zero where the cameras share their centre
    true: np.ndarray  # (N,) bool, False for outliers
    sigma_px: float

    @property
    def matches(self) -> Matches:
        sigma = max(self.sigma_px, 0.5)
        return Matches(self.points1, self.points2, np.ones(len(self.points1)), sigma)

    @property
    def cameras(self) -> tuple[Camera, Camera]:
        return Camera(self.K1, SIZE1), Camera(self.K2, SIZE1 if self.K2 is self.K1 else SIZE2)

    def problem(
        self, threshold: float = 2e-3, cells: tuple[float, float] = CELLS
    ) -> TwoViewProblem:
        """The normalised matches with a threshold and cells in the same unit."""
        camera1, camera2 = self.cameras
        points = camera1.normalise(self.points1), camera2.normalise(self.points2)
        return normalised_problem(*points, threshold, cells)


def normalised_problem(
    points1: np.ndarray,
    points2: np.ndarray,
    threshold: float = 2e-3,
    cells: tuple[float, float] = CELLS,
    seed: int = 0,
    key_points: bool = False,
) -> TwoViewProblem:
    """A problem of normalised points, all of them used."""
    count = len(points1)
    return TwoViewProblem(
        points1, points2, threshold, cells, seed, np.arange(count), np.ones(count), key_points
    )


def two_view_scene(
    kind: SceneKind = "general",
    *,
    seed: int = 0,
    count: int = 1000,
    sigma_px: float = 0.5,
    outliers: float = 0.3,
    rotation_deg: float = 20.0,
    same_camera: bool = False,
) -> TwoViewScene:
    """A scene of `count` matches, `outliers` of them anywhere, noise of `sigma_px` in each image.

    "identical" is the same view twice, one camera; "random" has no scene at all. The optical axes
    of "skew" do not meet, so that the matches tell the focal lengths; those of "orbit" do.
    """
    rng = np.random.default_rng(seed)
    same = same_camera or kind == "identical"
    first, second, size2 = K1, K1 if same else K2, SIZE1 if same else SIZE2
    R, t = _motion(kind, rng, rotation_deg)
    points = _points(kind, rng, 40 * count)
    seen1, in1 = _project(points, first, np.eye(3), np.zeros(3), SIZE1)
    seen2, in2 = _project(points, second, R, t, size2)
    both = np.flatnonzero(in1 & in2)[:count]
    if len(both) < count:
        raise AssertionError(f"a {kind} scene of seed {seed} shows only {len(both)} points")
    points1 = seen1[both] + sigma_px * rng.standard_normal((count, 2))
    points2 = seen2[both] + sigma_px * rng.standard_normal((count, 2))
    share = 1.0 if kind == "random" else outliers
    true = rng.permutation(count) >= round(share * count)
    wrong = int((~true).sum())
    points1[~true] = rng.random((wrong, 2)) * SIZE1
    points2[~true] = rng.random((wrong, 2)) * size2
    length = np.linalg.norm(t)
    direction = t / length if length > 0 else t
    return TwoViewScene(points1, points2, first, second, R, direction, true, sigma_px)


def poster_scene(
    *, seed: int = 0, count: int = 300, sigma_px: float = 0.4, relief: float = 0.0
) -> TwoViewScene:
    """A tilted poster that fills a quarter of the image: few points of it, or none, lie behind a
    camera in either of its homography's poses.

    relief: of the points off the plane, as a share of its width.
    """
    rng = np.random.default_rng(seed)
    points = np.column_stack([rng.uniform(-0.8, 0.8, (count, 2)), np.zeros(count)])
    points[:, 2] = 6 + 0.4 * points[:, 0] - 0.2 * points[:, 1]
    R = Rotation.from_rotvec(np.radians(18) * np.array([0.3, 0.9, 0.1])).as_matrix()
    middle = np.array([0.0, 0.0, 6.0])
    t = middle - R @ middle + 0.3 * rng.standard_normal(3)
    noise = sigma_px * rng.standard_normal((2, count, 2))
    points[:, 2] += 1.6 * relief * rng.uniform(-0.5, 0.5, count)
    views = ((np.eye(3), np.zeros(3)), (R, t))
    seen = [
        _project(points, K1, *view, SIZE1)[0] + off for view, off in zip(views, noise, strict=True)
    ]
    true = np.ones(count, dtype=bool)
    return TwoViewScene(*seen, K1, K1, R, t / np.linalg.norm(t), true, sigma_px)


def _motion(
    kind: SceneKind, rng: np.random.Generator, rotation_deg: float
) -> tuple[np.ndarray, np.ndarray]:
    if kind == "identical":
        return np.eye(3), np.zeros(3)
    axis = rng.standard_normal(3) * (0.3, 1.0, 0.3)
    R = Rotation.from_rotvec(np.radians(rotation_deg) * axis / np.linalg.norm(axis)).as_matrix()
    if kind == "rotation_only":
        return R, np.zeros(3)
    if kind == "forward":
        small = Rotation.from_rotvec(np.radians(2.0) * rng.standard_normal(3)).as_matrix()
        return small, np.array([0.02, 0.01, -1.5])
    if kind == "skew":
        R = R @ Rotation.from_euler("xz", (12.0, 15.0), degrees=True).as_matrix()
        return R, -R @ np.array([1.5, 1.2, 0.3])
    if kind == "orbit":
        R = Rotation.from_euler("y", rotation_deg, degrees=True).as_matrix()
        return R, np.array([0, 0, 6.0]) - R @ (0, 0, 6.0)
    # An orbit: the middle of the scene, 6 away, stays near the axis.
    middle = np.array([0.0, 0.0, 6.0])
    return R, middle - R @ middle + 0.3 * rng.standard_normal(3)


def _points(kind: SceneKind, rng: np.random.Generator, count: int) -> np.ndarray:
    spread = rng.uniform(-1, 1, (count, 3)) * (4.0, 3.0, 2.0)
    if kind == "planar":
        spread[:, 2] = 0.3 * spread[:, 0] - 0.2 * spread[:, 1]
    return spread + (0.0, 0.0, 6.0)


def _project(
    points: np.ndarray, K: np.ndarray, R: np.ndarray, t: np.ndarray, size: tuple[int, int]
) -> tuple[np.ndarray, np.ndarray]:
    local = points @ R.T + t
    pixels = (local @ K.T)[:, :2] / local[:, 2:]
    inside = (pixels >= 0).all(1) & (pixels <= np.subtract(size, 1)).all(1)
    return pixels, inside & (local[:, 2] > 0.1)


def assert_among(poses, R, t, most):
    """The pose is one of these to `most`, and each has a rotation and a direction of length 1."""
    assert min(np.abs(R_ - R).max() + np.abs(t_ - t).max() for R_, t_ in poses) < most
    for R_, t_ in poses:
        assert np.isclose(np.linalg.det(R_), 1) and np.isclose(np.linalg.norm(t_), 1)
