"""Points of a world, references on an arc, and a photograph: what a localization starts from."""

from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np
import pycolmap
from scipy.spatial.transform import Rotation

from dgc_pose.cameras.camera import Camera
from dgc_pose.estimation import EstimationOptions, RelativePose, estimate_pose
from dgc_pose.estimation.intrinsics_prior import SIZE
from dgc_pose.estimation.problem import Hypothesis, TwoViewProblem
from dgc_pose.localization.correspondences import PairCorrespondences, WorldPose
from dgc_pose.matches import Matches
from dgc_pose.model import Model

IMAGE = (1000, 800)
CAMERA = Camera(np.array([[900.0, 0, 500], [0, 905, 390], [0, 0, 1]]), IMAGE)
PHOTO_CAMERA = Camera(np.array([[1100.0, 0, 480], [0, 1100, 410], [0, 0, 1]]), IMAGE)
NOISE_PX = 0.4
OPTIONS = EstimationOptions()


def facing(centre: np.ndarray, roll: float = 0.0) -> np.ndarray:
    """R (3, 3) of a camera that faces the middle of the points."""
    z = np.array([0.0, 0, 6]) - centre
    z /= np.linalg.norm(z)
    x = np.cross((0.0, 1, 0), z)
    x /= np.linalg.norm(x)
    turned: np.ndarray = Rotation.from_euler("z", roll).as_matrix() @ np.stack(
        [x, np.cross(z, x), z]
    )
    return turned


@dataclass(frozen=True)
class WorldScene:
    """A photograph, references, and points that all of them show."""

    points: np.ndarray  # (N, 3)
    R: np.ndarray  # of the photograph
    centre: np.ndarray
    references: tuple[tuple[np.ndarray, np.ndarray], ...]  # R and centre

    def model(self) -> Model:
        """Without image files."""
        poses = {
            name: np.column_stack([R, -R @ centre])
            for name, (R, centre) in zip(self.names, self.references, strict=True)
        }
        return Model(Path("none"), dict.fromkeys(poses, CAMERA), poses)

    @property
    def names(self) -> list[str]:
        return [f"r{i}.jpg" for i in range(len(self.references))]

    def pixels(self, camera: Camera, R: np.ndarray, centre: np.ndarray) -> np.ndarray:
        """Of all points, without errors."""
        seen = (self.points - centre) @ R.T
        return camera.project(seen[:, :2] / seen[:, 2:])

    def matches(self, number: int, *, outliers: float = 0.2, seed: int = 0) -> Matches:
        """Of a reference and the photograph, with errors."""
        rng = np.random.default_rng((seed, number))
        points1 = self.pixels(CAMERA, *self.references[number])
        points2 = self.pixels(PHOTO_CAMERA, self.R, self.centre)
        points1 += rng.normal(0, NOISE_PX, points1.shape)
        points2 += rng.normal(0, NOISE_PX, points2.shape)
        wrong = rng.random(len(points1)) < outliers
        points2[wrong] = rng.uniform(0, IMAGE, (wrong.sum(), 2))
        return Matches(points1, points2, np.ones(len(points1)), 2 * NOISE_PX)

    def pair_pose(
        self, number: int, seed: int = 0, probability: float | None = 0.98
    ) -> RelativePose:
        """The pose of a pair, which is that probable; None: not known."""
        pose = estimate_pose(self.matches(number, seed=seed), CAMERA, PHOTO_CAMERA, OPTIONS)
        return replace(pose, probability=probability, any_probability=probability)

    def sight(
        self, number: int, seed: int = 0, photo: Camera = PHOTO_CAMERA
    ) -> PairCorrespondences:
        R, centre = self.references[number]
        problem = TwoViewProblem.of(self.matches(number, seed=seed), CAMERA, photo, OPTIONS)
        t = self.R @ (centre - self.centre)
        hypothesis = Hypothesis.of_pose(problem, self.R @ R.T, t / np.linalg.norm(t))
        return PairCorrespondences(R, centre, problem, [hypothesis])

    @property
    def pose(self) -> WorldPose:
        return WorldPose(self.R, self.centre, np.zeros(SIZE))


def world_scene(
    centres: np.ndarray | None = None, *, count: int = 300, seed: int = 0
) -> WorldScene:
    """A photograph near the origin. centres: (N, 3) of the references; five on an arc without."""
    rng = np.random.default_rng(seed)
    points = rng.uniform((-2, -1.5, 4.5), (2, 1.5, 7.5), (count, 3))
    if centres is None:
        x = np.array([-1.4, -0.7, 0.6, 1.2, 1.8])
        centres = np.column_stack([x, 0.3 * np.cos(3 * x), 0.1 * x**2])
    references = tuple((facing(c, 0.1 * i), c) for i, c in enumerate(centres))
    centre = np.array([0.1, -0.2, 0.15])
    return WorldScene(points, facing(centre, 0.2), centre, references)


def write_colmap(
    scene: WorldScene, folder: Path, camera: pycolmap.Camera | None = None, *, binary: bool = True
) -> Path:
    """The scene as pycolmap writes it, by default with `CAMERA`; its points are in two images."""
    if camera is None:
        camera = pycolmap.Camera.create_from_model_name(1, "PINHOLE", 1.0, *IMAGE)
        camera.params = [CAMERA.K[0, 0], CAMERA.K[1, 1], *(CAMERA.K[:2, 2] + 0.5)]
    camera.camera_id = 1
    model = pycolmap.Reconstruction()
    model.add_camera_with_trivial_rig(camera)
    for number, (name, (R, centre)) in enumerate(
        zip(scene.names, scene.references, strict=True), start=1
    ):
        seen = camera.img_from_cam((scene.points - centre) @ R.T)
        image = pycolmap.Image(name=name, camera_id=1, keypoints=seen)
        image.image_id = number
        pose = pycolmap.Rigid3d(pycolmap.Rotation3d(R), -R @ centre)
        model.add_image_with_trivial_frame(image, pose)
    for index, point in enumerate(scene.points):
        track = pycolmap.Track()
        for number in (1, 2):
            track.add_element(number, index)
        model.add_point3D(point, track)
    folder.mkdir(parents=True)
    (model.write_binary if binary else model.write_text)(folder)
    return folder
