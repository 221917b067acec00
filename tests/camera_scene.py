"""Matches of a scene that two cameras of any kind see: points are projected exactly."""

from dataclasses import dataclass, replace

import numpy as np
from scipy.spatial.transform import Rotation

from dgc_pose.cameras.camera import Camera
from dgc_pose.cameras.colmap_camera import Distortion
from dgc_pose.cameras.prior import auto_cameras
from dgc_pose.estimation import EstimationOptions, RelativePose, estimate_pose
from dgc_pose.images.header import Exif, Header
from dgc_pose.matches import Matches
from dgc_pose.metrics import rotation_error_deg, translation_error_deg

NO_EXIF = Exif()


@dataclass(frozen=True)
class CameraScene:
    """Matches of two views with all that is true of them."""

    matches: Matches
    cameras: tuple[Camera, Camera]  # that saw the points
    R: np.ndarray  # (3, 3), x2 = R x1 + t
    t: np.ndarray  # (3,) unit length
    true: np.ndarray  # (N,) bool, False for outliers

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


def camera_scene(
    camera1: Camera,
    camera2: Camera,
    *,
    seed: int = 0,
    count: int = 800,
    sigma_px: float = 0.4,
    outliers: float = 0.2,
    turn_deg: tuple[float, float, float] = (8.0, 15.0, 12.0),
    centre: tuple[float, float, float] = (1.5, 1.2, 0.3),
    depths: tuple[float, float] = (4.0, 9.0),
    weights: str | None = None,
) -> CameraScene:
    """`count` matches, `outliers` of them anywhere, with a noise of `sigma_px` in each image.

    turn_deg: about the axes x, y and z. centre: of camera 2; by default the optical axes do not
    meet, so that the matches tell the focal lengths. depths: the range of z in camera 1. weights:
    the fingerprint of the network that the matches are said to be of.
    """
    rng = np.random.default_rng(seed)
    R = Rotation.from_euler("xyz", turn_deg, degrees=True).as_matrix()
    t = -R @ centre
    pixels = rng.random((40 * count, 2)) * np.subtract(camera1.size, 1)
    points = np.column_stack([camera1.normalise(pixels), np.ones(len(pixels))])
    points *= rng.uniform(*depths, (len(points), 1))
    local = points @ R.T + t
    ahead = np.isfinite(local).all(1) & (local[:, 2] > 0.1)
    pixels, local = pixels[ahead], local[ahead]
    seen = camera2.project(local[:, :2] / local[:, 2:])
    inside = ((seen >= 0) & (seen <= np.subtract(camera2.size, 1))).all(1)
    both = np.flatnonzero(inside)[:count]
    if len(both) < count:
        raise AssertionError(f"a scene of seed {seed} shows only {len(both)} points")
    points1, points2 = (
        view[both] + sigma_px * rng.standard_normal((count, 2)) for view in (pixels, seen)
    )
    true = rng.permutation(count) >= round(outliers * count)
    wrong = int((~true).sum())
    points1[~true] = rng.random((wrong, 2)) * camera1.size
    points2[~true] = rng.random((wrong, 2)) * camera2.size
    matches = Matches(points1, points2, np.ones(count), max(sigma_px, 0.5), weights=weights)
    return CameraScene(matches, (camera1, camera2), R, t / np.linalg.norm(t), true)


def joined(scene: CameraScene, points1: np.ndarray, points2: np.ndarray) -> CameraScene:
    """The scene with further matches, none of them true, at the end."""
    rows = [
        np.vstack(pair)
        for pair in ((scene.matches.points1, points1), (scene.matches.points2, points2))
    ]
    matches = replace(
        scene.matches, points1=rows[0], points2=rows[1], confidence=np.ones(len(rows[0]))
    )
    true = np.concatenate([scene.true, np.zeros(len(points1), dtype=bool)])
    return replace(scene, matches=matches, true=true)
