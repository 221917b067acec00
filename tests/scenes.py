"""Seeded two-view scenes of points, of every kind that the estimator must tell apart. Points are
projected exactly, and matches have noise and outliers. Pixels, (0, 0) the first one's centre; poses
take x1 to x2 = R x1 + t."""

from dataclasses import dataclass, replace
from typing import Any, Literal, get_args

import numpy as np
from scipy.spatial.transform import Rotation

from dgc_pose.cameras.camera import Camera
from dgc_pose.cameras.colmap_camera import Distortion
from dgc_pose.cameras.prior import auto_cameras
from dgc_pose.estimation import EstimationOptions, RelativePose, estimate_pose
from dgc_pose.estimation.problem import TwoViewProblem
from dgc_pose.images.decoding import Exif, Header
from dgc_pose.matches import Matches
from dgc_pose.metrics import rotation_error_deg, translation_error_deg

SceneKind = Literal[
    "general", "skew", "orbit", "planar", "rotation_only", "forward", "identical", "random"
]
SCENE_KINDS: tuple[SceneKind, ...] = get_args(SceneKind)
CELLS = (0.05, 0.05)  # sides of a grid cell: a thirtieth of the images' width, normalised
SIZE1, SIZE2 = (1600, 1200), (1280, 960)
K1 = np.array([[1700.0, 0, 810], [0, 1690, 590], [0, 0, 1]])
K2 = np.array([[1100.0, 0, 630], [0, 1110, 490], [0, 0, 1]])
MIDDLE = np.array([0.0, 0.0, 6.0])  # of the points
NO_EXIF = Exif()
HERE = np.eye(3), np.zeros(3)  # the pose of camera 1


@dataclass(frozen=True)
class TwoViewScene:
    """Matches of two views with all that is true of them."""

    matches: Matches
    cameras: tuple[Camera, Camera]  # that saw the points
    R: np.ndarray  # (3, 3)
    t: np.ndarray  # (3,) unit length; zero where the cameras share their centre
    true: np.ndarray  # (N,) bool, False for outliers

    @property
    def points1(self) -> np.ndarray:
        return self.matches.points1

    @property
    def points2(self) -> np.ndarray:
        return self.matches.points2

    @property
    def K1(self) -> np.ndarray:
        return self.cameras[0].K

    @property
    def K2(self) -> np.ndarray:
        return self.cameras[1].K

    def problem(
        self, threshold: float = 2e-3, cells: tuple[float, float] = CELLS
    ) -> TwoViewProblem:
        """The normalised matches with a threshold and cells in the same unit."""
        camera1, camera2 = self.cameras
        points = camera1.normalise(self.points1), camera2.normalise(self.points2)
        return normalised_problem(*points, threshold, cells)

    def auto(self, exif: Exif = NO_EXIF) -> tuple[Camera, Camera]:
        """The cameras of photographs of these sizes without a K."""
        first, second = (Header("JPEG", camera.size, exif) for camera in self.cameras)
        return auto_cameras(first, second)

    def estimate(self, *cameras: Camera, seed: int = 0) -> RelativePose:
        """By `auto` without cameras."""
        return estimate_pose(self.matches, *(cameras or self.auto()), EstimationOptions(seed=seed))

    def errors_deg(self, pose: RelativePose) -> tuple[float, float]:
        """Of R and of t."""
        return rotation_error_deg(pose.R, self.R), translation_error_deg(pose.t, self.t)


def normalised_problem(
    points1: np.ndarray,
    points2: np.ndarray,
    threshold: float = 2e-3,
    cells: tuple[float, float] = CELLS,
    seed: int = 0,
    key_points: bool = False,
) -> TwoViewProblem:
    """A problem of normalised points, all of them used."""
    matches = Matches(points1, points2, np.ones(len(points1)), 1.0, key_points)
    cameras = Camera(np.eye(3)), Camera(np.eye(3))
    every, options = np.arange(len(points1)), EstimationOptions(seed=seed)
    return TwoViewProblem(matches, cameras, options, points1, points2, every, threshold, cells)


def two_views(
    points: np.ndarray,
    cameras: tuple[Camera, Camera],
    pose: tuple[np.ndarray, np.ndarray],
    rng: np.random.Generator,
    *,
    count: int | None = None,
    sigma_px: float = 0.0,
    outliers: float = 0.0,
    everywhere: bool = False,
) -> TwoViewScene:
    """Matches of points (N, 3) before both cameras, in axes of camera 1, with noise of `sigma_px`
    in each image, `outliers` of them anywhere.

    pose: R (3, 3) and t (3,). count: the first so many; None: all. everywhere: also those outside
    the images.
    """
    R, t = pose
    moved = points @ R.T + t
    ahead = np.isfinite(moved).all(1) & (points[:, 2] > 0.1) & (moved[:, 2] > 0.1)
    seen = []
    inside = np.ones(ahead.sum(), bool)
    for camera, view in zip(cameras, (points[ahead], moved[ahead]), strict=True):
        pixels = camera.project(view[:, :2] / view[:, 2:])
        seen.append(pixels)
        assert camera.size is not None
        inside &= (pixels >= 0).all(1) & (pixels <= np.subtract(camera.size, 1)).all(1)
    both = np.flatnonzero(inside | everywhere)[:count]
    if len(both) < (count or 0):
        raise AssertionError(f"the scene shows only {len(both)} points")

    seen = [pixels[both] for pixels in seen]
    true = np.ones(len(both), bool)
    if sigma_px:
        seen = [pixels + sigma_px * rng.standard_normal(pixels.shape) for pixels in seen]
    if outliers:
        true = rng.permutation(len(both)) >= round(outliers * len(both))
        for pixels, camera in zip(seen, cameras, strict=True):
            pixels[~true] = rng.random((int((~true).sum()), 2)) * camera.size
    matches = Matches(*seen, np.ones(len(both)), max(sigma_px, 0.5))
    return TwoViewScene(matches, cameras, R, t / (np.linalg.norm(t) or 1.0), true)


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
    """`two_views` of a box of points.

    "identical" is the same view twice, one camera; "random" has no scene at all. The optical axes
    of "skew" do not meet, so that the matches tell the focal lengths; those of "orbit" do.
    """
    rng = np.random.default_rng(seed)
    same = same_camera or kind == "identical"
    cameras = Camera(K1, SIZE1), Camera(K1, SIZE1) if same else Camera(K2, SIZE2)
    pose = _motion(kind, rng, rotation_deg)
    points = rng.uniform(-1, 1, (40 * count, 3)) * (4.0, 3.0, 2.0)
    if kind == "planar":
        points[:, 2] = 0.3 * points[:, 0] - 0.2 * points[:, 1]
    share = 1.0 if kind == "random" else outliers
    drawn = {"count": count, "sigma_px": sigma_px, "outliers": share}
    return two_views(points + MIDDLE, cameras, pose, rng, **drawn)


def camera_scene(
    camera1: Camera,
    camera2: Camera,
    *,
    seed: int = 0,
    turn_deg: tuple[float, float, float] = (8.0, 15.0, 12.0),
    centre: tuple[float, float, float] = (1.5, 1.2, 0.3),
    depths: tuple[float, float] = (4.0, 9.0),
    weights: str | None = None,
    **drawn: Any,
) -> TwoViewScene:
    """`two_views` of cameras of any kind: 800 points that lie all over image 1.

    turn_deg: about x, y and z. centre: of camera 2; by default the optical axes do not meet.
    depths: the range of z in camera 1. weights: the fingerprint of the matches' network.
    """
    drawn = {"count": 800, "sigma_px": 0.4, "outliers": 0.2} | drawn
    rng = np.random.default_rng(seed)
    R = Rotation.from_euler("xyz", turn_deg, degrees=True).as_matrix()
    pixels = rng.random((40 * drawn["count"], 2)) * np.subtract(camera1.size, 1)
    points = np.column_stack([camera1.normalise(pixels), np.ones(len(pixels))])
    points *= rng.uniform(*depths, (len(points), 1))
    scene = two_views(points, (camera1, camera2), (R, -R @ centre), rng, **drawn)
    return replace(scene, matches=replace(scene.matches, weights=weights))


def pinhole(
    focal: float,
    size: tuple[int, int],
    lens: Distortion | None = None,
    *,
    aspect: float = 1.0,
    centre: tuple[float, float] = (0.0, 0.0),
) -> Camera:
    """fx is `focal` times `aspect`, fy is `focal`; the principal point is `centre` pixels from the
    middle."""
    x, y = (np.array(size) - 1) / 2 + centre
    return Camera(np.array([[focal * aspect, 0, x], [0, focal, y], [0, 0, 1]]), size, lens)


def poster_scene(*, seed: int = 0, count: int = 300, sigma_px: float = 0.4) -> TwoViewScene:
    """A tilted poster that fills a quarter of the image: few points of it, or none, lie behind a
    camera in either of its homography's poses."""
    rng = np.random.default_rng(seed)
    x, y = rng.uniform(-0.8, 0.8, (count, 2)).T
    points = np.column_stack([x, y, 6 + 0.4 * x - 0.2 * y])
    R = Rotation.from_rotvec(np.radians(18) * np.array([0.3, 0.9, 0.1])).as_matrix()
    t = MIDDLE - R @ MIDDLE + 0.3 * rng.standard_normal(3)
    cameras = (Camera(K1, SIZE1),) * 2
    return two_views(points, cameras, (R, t), rng, sigma_px=sigma_px, everywhere=True)


def joined(scene: TwoViewScene, points1: np.ndarray, points2: np.ndarray) -> TwoViewScene:
    """The scene with further matches, none of them true, at the end."""
    points1, points2 = np.vstack([scene.points1, points1]), np.vstack([scene.points2, points2])
    new = replace(scene.matches, points1=points1, points2=points2, confidence=np.ones(len(points1)))
    true = np.pad(scene.true, (0, len(points1) - len(scene.true)))
    return replace(scene, matches=new, true=true)


def project(
    points: np.ndarray, K: np.ndarray, R: np.ndarray = HERE[0], t: np.ndarray = HERE[1]
) -> np.ndarray:
    """Pixels (N, 2) of points (N, 3)."""
    pixels = (points @ R.T + t) @ K.T
    return pixels[:, :2] / pixels[:, 2:]


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
        return R, MIDDLE - R @ MIDDLE
    # An orbit: the middle of the scene, 6 away, stays near the axis.
    return R, MIDDLE - R @ MIDDLE + 0.3 * rng.standard_normal(3)


def assert_among(poses, R, t, most):
    """The pose is one of these to `most`, and each has a rotation and a direction of length 1."""
    assert min(np.abs(R_ - R).max() + np.abs(t_ - t).max() for R_, t_ in poses) < most
    for R_, t_ in poses:
        assert np.isclose(np.linalg.det(R_), 1) and np.isclose(np.linalg.norm(t_), 1)
