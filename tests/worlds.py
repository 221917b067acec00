"""Scenes of many views: rendered views of planes in a corner of a room, ray-cast; and points of a
world, references on an arc and a photograph, which a localization starts from."""

from collections.abc import Sequence
from dataclasses import dataclass, replace
from functools import cache
from pathlib import Path

import cv2
import numpy as np
import pycolmap
from scenes import TwoViewScene, two_views
from scipy.spatial.transform import Rotation

from dgc_pose.cameras.camera import Camera
from dgc_pose.estimation import EstimationOptions, RelativePose, estimate_pose, intrinsics_prior
from dgc_pose.estimation.problem import Hypothesis, TwoViewProblem
from dgc_pose.localization.correspondences import PairCorrespondences, WorldPose
from dgc_pose.matches import Matches
from dgc_pose.model import Model

SIZE = (240, 180)
K = np.array([[225.0, 0, 121.0], [0, 226.5, 87.5], [0, 0, 1]])  # of all rendered views
_TEXELS = 100.0  # for one unit of length
# Planes n.x = d, each within half of a length of its middle along both of its axes.
_PLANES = (
    # middle, axis u, axis v, half sides
    ((0.0, 0.0, 6.0), (1, 0, 0), (0, 1, 0), (4.0, 3.0)),
    ((0.0, 1.6, 4.0), (1, 0, 0), (0, 0, 1), (4.0, 3.0)),
    ((-2.4, 0.0, 4.0), (0, 1, 0), (0, 0, 1), (3.0, 3.0)),
    ((0.5, 0.6, 4.2), (1, 0, 0.3), (0, 1, 0), (0.7, 0.9)),
    ((-0.9, 0.4, 4.8), (1, 0, -0.4), (0, 1, 0.1), (0.6, 0.7)),
)


@dataclass(frozen=True)
class View:
    """An image and its pose, x_camera = R x + t."""

    pixels: np.ndarray  # (H, W, 3) uint8
    R: np.ndarray  # (3, 3)
    t: np.ndarray  # (3,)

    @property
    def centre(self) -> np.ndarray:
        return -self.R.T @ self.t


def render_views(
    count: int,
    *,
    seed: int = 0,
    step: float = 0.35,
    K: np.ndarray = K,
    size: tuple[int, int] = SIZE,
) -> list[View]:
    """Views of cameras on an arc of `step` units between neighbours, which look at the middle."""
    textures = draw_textures(seed)
    views = []
    for i in range(count):
        x = (i - (count - 1) / 2) * step
        centre = np.array([x, 0.15 * np.sin(2.0 * i), 0.05 * x * x + 0.1 * np.cos(1.5 * i)])
        R = look_at(centre, np.array([0.0, 0.2, 4.6]))
        views.append(View(render(R, centre, textures, K, size)[0], R, -R @ centre))
    return views


def write_views(folder: Path, views: list[View]) -> list[str]:
    """Write the images as view0.png and so on; returns their names."""
    folder.mkdir(parents=True, exist_ok=True)
    names = [f"view{i}.png" for i in range(len(views))]
    for name, view in zip(names, views, strict=True):
        cv2.imwrite(str(folder / name), view.pixels[:, :, ::-1])
    return names


def known_model(folder: Path, views: list[View]) -> Model:
    """The images, written to the folder, with their true poses and camera."""
    names = write_views(folder, views)
    poses = {n: np.column_stack([v.R, v.t]) for n, v in zip(names, views, strict=True)}
    return Model(folder, dict.fromkeys(names, Camera(K, SIZE)), poses)


def K_text(K: np.ndarray = K) -> str:
    """K as on the command line."""
    return f"{K[0, 0]},{K[1, 1]},{K[0, 2]},{K[1, 2]}"


@cache
def draw_textures(seed: int = 0) -> list[np.ndarray]:
    """Of the planes."""
    rng, side, textures = np.random.default_rng(seed), int(8 * _TEXELS), []
    for _ in _PLANES:
        layers = []
        for cell, weight in ((10, 0.7), (25, 0.8), (60, 0.6)):
            noise = rng.standard_normal((side // cell + 2, side // cell + 2, 3)).astype(np.float32)
            layers.append(weight * cv2.resize(noise, (side, side), interpolation=cv2.INTER_CUBIC))
        textures.append(np.clip(127 + 50 * np.sum(layers, axis=0), 0, 255).astype(np.float32))
    return textures


def look_at(centre: np.ndarray, target: np.ndarray) -> np.ndarray:
    """R (3, 3) of an upright camera."""
    z = (target - centre) / np.linalg.norm(target - centre)
    x = np.cross((0.0, 1.0, 0.0), z)
    x /= np.linalg.norm(x)
    return np.stack([x, np.cross(z, x), z])


def render(
    R: np.ndarray,
    centre: np.ndarray,
    textures: list[np.ndarray],
    K: np.ndarray = K,
    size: tuple[int, int] = SIZE,
    fine: int = 2,
) -> tuple[np.ndarray, np.ndarray]:
    """The image (H, W, 3) of a camera, uint8, and its depths, infinite where there is no plane.

    The depths are those of the `fine` samples that a pixel has along each axis.
    """
    u, v = np.meshgrid(*((np.arange(side * fine) + 0.5) / fine - 0.5 for side in size))
    rays = np.stack([u, v, np.ones_like(u)], -1) @ np.linalg.inv(K).T @ R
    nearest = np.full(u.shape, np.inf)
    colours = np.zeros((*u.shape, 3), np.float32)
    for (middle, axis_u, axis_v, half), texture in zip(_PLANES, textures, strict=True):
        along_u = np.divide(axis_u, np.linalg.norm(axis_u))
        along_v = np.divide(axis_v, np.linalg.norm(axis_v))
        normal = np.cross(along_u, along_v)
        with np.errstate(divide="ignore", invalid="ignore"):
            depth = normal @ (np.array(middle) - centre) / (rays @ normal)
            offset = centre + depth[..., None] * rays - middle
            a, b = offset @ along_u, offset @ along_v
        hit = (depth > 0.1) & (depth < nearest) & (abs(a) < half[0]) & (abs(b) < half[1])
        x = (np.where(hit, a, 0) * _TEXELS + texture.shape[1] / 2).astype(np.float32)
        y = (np.where(hit, b, 0) * _TEXELS + texture.shape[0] / 2).astype(np.float32)
        sampled = cv2.remap(texture, x, y, cv2.INTER_LINEAR, borderMode=cv2.BORDER_REFLECT)
        colours[hit] = sampled[hit]
        nearest[hit] = depth[hit]
    pixels = np.rint(cv2.resize(colours, size, interpolation=cv2.INTER_AREA)).astype(np.uint8)
    return pixels, nearest


IMAGE = (1000, 800)
CAMERA = Camera(np.array([[900.0, 0, 500], [0, 905, 390], [0, 0, 1]]), IMAGE)
PHOTO_CAMERA = Camera(np.array([[1100.0, 0, 480], [0, 1100, 410], [0, 0, 1]]), IMAGE)
NOISE_PX = 0.4
OPTIONS = EstimationOptions()


@dataclass(frozen=True)
class WorldScene:
    """A photograph, references, and points that all of them show."""

    points: np.ndarray  # (N, 3)
    R: np.ndarray  # of the photograph
    centre: np.ndarray
    references: tuple[tuple[np.ndarray, np.ndarray], ...]  # R and centre

    def model(self) -> Model:
        """Without image files."""
        poses = [np.column_stack([R, -R @ centre]) for R, centre in self.references]
        cameras = dict.fromkeys(self.names, CAMERA)
        return Model(Path("none"), cameras, dict(zip(self.names, poses, strict=True)))

    @property
    def names(self) -> list[str]:
        return [f"r{i}.jpg" for i in range(len(self.references))]

    def pixels(self, camera: Camera, R: np.ndarray, centre: np.ndarray) -> np.ndarray:
        """Of all points, without errors."""
        seen = (self.points - centre) @ R.T
        return camera.project(seen[:, :2] / seen[:, 2:])

    def seen(self, number: int, *, outliers: float = 0.2, seed: int = 0) -> TwoViewScene:
        """By a reference and the photograph, with errors."""
        R, centre = self.references[number]
        pose = self.R @ R.T, self.R @ (centre - self.centre)
        cameras = CAMERA, PHOTO_CAMERA
        rng = np.random.default_rng((seed, number))
        points = (self.points - centre) @ R.T
        scene = two_views(points, cameras, pose, rng, sigma_px=NOISE_PX, everywhere=True)
        wrong = rng.random(len(points)) < outliers
        scene.points2[wrong] = rng.uniform(0, IMAGE, (wrong.sum(), 2))
        return replace(scene, matches=replace(scene.matches, error_px=2 * NOISE_PX))

    def matches(self, number: int, *, outliers: float = 0.2, seed: int = 0) -> Matches:
        return self.seen(number, outliers=outliers, seed=seed).matches

    def pair_pose(
        self, number: int, seed: int = 0, probability: float | None = 0.98
    ) -> RelativePose:
        """The pose of a pair, which is that probable; None: not known."""
        pose = estimate_pose(self.matches(number, seed=seed), CAMERA, PHOTO_CAMERA, OPTIONS)
        return replace(pose, probability=probability, any_probability=probability)

    def sight(
        self, number: int, seed: int = 0, photo: Camera = PHOTO_CAMERA
    ) -> PairCorrespondences:
        scene = self.seen(number, seed=seed)
        problem = TwoViewProblem.of(scene.matches, CAMERA, photo, OPTIONS)
        hypothesis = Hypothesis.of_pose(problem, scene.R, scene.t)
        return PairCorrespondences(*self.references[number], problem, [hypothesis])

    @property
    def pose(self) -> WorldPose:
        return WorldPose(self.R, self.centre, np.zeros(intrinsics_prior.SIZE))


def world_scene(
    centres: np.ndarray | None = None, *, count: int = 300, seed: int = 0
) -> WorldScene:
    """A photograph near the origin. centres: (N, 3) of the references; five on an arc without."""
    rng = np.random.default_rng(seed)
    points = rng.uniform((-2, -1.5, 4.5), (2, 1.5, 7.5), (count, 3))
    if centres is None:
        x = np.array([-1.4, -0.7, 0.6, 1.2, 1.8])
        centres = np.column_stack([x, 0.3 * np.cos(3 * x), 0.1 * x**2])

    def facing(centre: np.ndarray, roll: float) -> tuple[np.ndarray, np.ndarray]:
        turn = Rotation.from_euler("z", roll).as_matrix()
        return turn @ look_at(centre, np.array([0.0, 0, 6])), centre

    references = tuple(facing(c, 0.1 * i) for i, c in enumerate(centres))
    return WorldScene(points, *facing(np.array([0.1, -0.2, 0.15]), 0.2), references)


def colmap_model(
    names: Sequence[str],
    references: Sequence[tuple[np.ndarray, np.ndarray]],
    camera: pycolmap.Camera,
    points: Sequence[np.ndarray] = (),
) -> pycolmap.Reconstruction:
    """Images of one camera with R (3, 3) and centre (3,); points (3,) in the first two images."""
    camera.camera_id = 1
    model = pycolmap.Reconstruction()
    model.add_camera_with_trivial_rig(camera)
    for number, (name, (R, centre)) in enumerate(zip(names, references, strict=True), start=1):
        seen = np.array([camera.img_from_cam(R @ (point - centre)) for point in points])
        image = pycolmap.Image(name, camera_id=1, image_id=number, keypoints=seen.reshape(-1, 2))
        pose = pycolmap.Rigid3d(pycolmap.Rotation3d(R), -R @ centre)
        model.add_image_with_trivial_frame(image, pose)
    for index, point in enumerate(points):
        track = pycolmap.Track()
        for number in (1, 2):
            track.add_element(number, index)
        model.add_point3D(point, track)
    return model


def write_colmap(
    scene: WorldScene, folder: Path, camera: pycolmap.Camera | None = None, *, binary: bool = True
) -> Path:
    """The scene as pycolmap writes it, by default with `CAMERA`; its points are in two images."""
    if camera is None:
        camera = pycolmap.Camera.create_from_model_name(1, "PINHOLE", 1.0, *IMAGE)
        camera.params = [CAMERA.K[0, 0], CAMERA.K[1, 1], *(CAMERA.K[:2, 2] + 0.5)]
    model = colmap_model(scene.names, scene.references, camera, scene.points)
    folder.mkdir(parents=True)
    (model.write_binary if binary else model.write_text)(folder)
    return folder
