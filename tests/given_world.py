"""A world of points as the matches of another program: key points of photographs on an arc, and
matches between them, of which some are wrong."""

from dataclasses import dataclass
from itertools import combinations
from pathlib import Path

import h5py
import numpy as np
import pycolmap
from worlds import CAMERA, IMAGE, WorldScene, world_scene

from dgc_pose.cameras.camera import Camera
from dgc_pose.metrics import rotation_error_deg, translation_error_deg

COLMAP_CENTRE = 0.5  # of the first pixel
Pair = tuple[str, str]


@dataclass(frozen=True)
class GivenWorld:
    """Key points (N, 2), (0, 0) the first pixel's centre, and matches (M, 2), by names."""

    scene: WorldScene
    names: tuple[str, ...]
    key_points: dict[str, np.ndarray]
    matches: dict[Pair, np.ndarray]
    right: dict[Pair, np.ndarray]  # (M,) bool: which matches are of one point
    unrelated: frozenset[Pair]  # whose matches are wrong

    def points(self, names: Pair) -> tuple[np.ndarray, np.ndarray]:
        """Of the matches of a pair, in both images."""
        index = self.matches[names]
        first, second = names
        return self.key_points[first][index[:, 0]], self.key_points[second][index[:, 1]]

    def errors_deg(self, names: Pair, R: np.ndarray, t: np.ndarray) -> tuple[float, float]:
        """The errors of R and of t."""
        (R1, centre1), (R2, centre2) = (self.scene.references[self.names.index(n)] for n in names)
        return (
            rotation_error_deg(R, R2 @ R1.T),
            translation_error_deg(t, R2 @ (centre1 - centre2)),
        )


def given_world(
    *, count: int = 5, points: int = 200, wrong: float = 0.2, unrelated: int = 1, seed: int = 0
) -> GivenWorld:
    """All pairs of `count` photographs of one place. The last `unrelated` photographs show nothing
    of it."""
    rng = np.random.default_rng(seed)
    x = np.linspace(-1.6, 1.8, count)
    centres = np.column_stack([x, 0.3 * np.cos(3 * x), 0.1 * x**2])
    scene = world_scene(centres, count=points, seed=seed)
    names = tuple(f"rows/photo {number}.jpg" for number in range(count))
    order = {}
    key_points = {}
    for name, pose in zip(names, scene.references, strict=True):
        pixels = scene.pixels(CAMERA, *pose)
        pixels += rng.normal(0, 0.4, pixels.shape)
        if name in names[count - unrelated :]:
            pixels = rng.uniform(0, IMAGE, pixels.shape)
        order[name] = rng.permutation(points)
        key_points[name] = pixels[order[name]]
    matches = {}
    right = {}
    for first, second in combinations(names, 2):
        index = np.column_stack([np.argsort(order[first]), np.argsort(order[second])])
        odd = np.flatnonzero(rng.random(points) < wrong)
        index[odd, 1] = rng.permutation(index[odd, 1])
        matches[first, second] = index.astype(np.uint32)
        right[first, second] = index[:, 1] == np.argsort(order[second])
    apart = {pair for pair in matches if {*pair} & {*names[count - unrelated :]}}
    return GivenWorld(scene, names, key_points, matches, right, frozenset(apart))


def write_with_pycolmap(
    world: GivenWorld, path: Path, *, columns: int = 4, known: bool = True, camera: Camera = CAMERA
) -> Path:
    """The world as pycolmap writes it, its raw matches alone."""
    with pycolmap.Database.open(path) as database:
        stored = pycolmap.Camera.create_from_model_name(0, "PINHOLE", 1.0, *IMAGE)
        K = camera.K
        stored.params = [K[0, 0], K[1, 1], K[0, 2] + COLMAP_CENTRE, K[1, 2] + COLMAP_CENTRE]
        stored.has_prior_focal_length = known
        stored.camera_id = database.write_camera(stored)
        rig = pycolmap.Rig(rig_id=stored.camera_id)
        rig.add_ref_sensor(stored.sensor_id)
        database.write_rig(rig, use_rig_id=True)
        ids = {}
        for name in reversed(world.names):  # the ids are not in the order of the names
            image = pycolmap.Image(name=name, camera_id=stored.camera_id)
            image.image_id = ids[name] = database.write_image(image)
            frame = pycolmap.Frame(frame_id=image.image_id, rig_id=rig.rig_id)
            frame.add_data_id(image.data_id)
            database.write_frame(frame, use_frame_id=True)
            points = world.key_points[name] + COLMAP_CENTRE
            more = np.ones((len(points), columns - 2))
            database.write_keypoints(ids[name], np.column_stack([points, more]).astype(np.float32))
        for (first, second), index in world.matches.items():
            database.write_matches(ids[first], ids[second], index)
    return path


def write_hloc(world: GivenWorld, folder: Path, mark: str = "/", *, sizes: bool = True) -> Path:
    """The world in hloc's layout. mark: between the names of a pair, "_" by older versions."""
    folder.mkdir(exist_ok=True)
    with h5py.File(folder / "feats-any.h5", "w") as file:
        for name, points in world.key_points.items():
            file[f"{name}/keypoints"] = points.astype(np.float32)
            if sizes:
                file[f"{name}/image_size"] = np.array(IMAGE)
    with h5py.File(folder / "feats-any_matches-any.h5", "w") as file:
        for names, index in world.matches.items():
            group = mark.join(name.replace("/", "-") for name in names)
            matches0 = np.full(len(world.key_points[names[0]]), -1, np.int32)
            matches0[index[:, 0]] = index[:, 1]
            file[f"{group}/matches0"] = matches0
            file[f"{group}/matching_scores0"] = np.full(len(matches0), 0.9, np.float16)
    return folder


def write_npz(world: GivenWorld, folder: Path, *, named: bool = True) -> Path:
    """The world as a folder of key points of pairs. named: whether the files state the images."""
    folder.mkdir(exist_ok=True)
    for first, second in world.matches:
        points1, points2 = world.points((first, second))
        stated = {"image1": first, "image2": second} if named else {}
        file = f"{Path(first).name}_{Path(second).name}.npz"
        np.savez(folder / file, points1=points1, points2=points2, key_points=True, **stated)
    return folder
