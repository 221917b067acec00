"""A smooth surface, bent enough not to pass for a plane, seen by two known cameras: two textured
pictures and the exact dense map, by the surface's depth in camera 2."""

from collections.abc import Callable
from pathlib import Path

import cv2
import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from dgc_pose.images.image import Image
from dgc_pose.matching import (
    CorrespondenceMap,
    MatchingOptions,
    MatchResult,
    NetworkMatcher,
    select_matches,
)

SIZE = (320, 240)  # width, height, pixels
K = np.array([[300.0, 0.0, 159.5], [0.0, 300.0, 119.5], [0.0, 0.0, 1.0]])
K_TEXT = "300,300,159.5,119.5"
R = Rotation.from_euler("yx", [14, -5], degrees=True).as_matrix()
T = np.array([-0.95, 0.2, 0.25]) / np.linalg.norm([-0.95, 0.2, 0.25])
CELLS = 160  # of the map's grid, along each side


class MapMatcher(NetworkMatcher):
    """A network whose map is this one for any two images."""

    fingerprint = None  # type: ignore[assignment]

    def __init__(
        self,
        correspondence_map: CorrespondenceMap,
        options: MatchingOptions | None = None,
    ) -> None:
        self.name, self.correspondence_map = "map", correspondence_map
        self.options = options or MatchingOptions(aligned="none")
        self.engine = None  # type: ignore[assignment]

    def _match(self, image1: Image, image2: Image) -> MatchResult:
        matches = select_matches(self.correspondence_map, self.options)
        return MatchResult(matches, self.correspondence_map)


def replace_network(
    monkeypatch: pytest.MonkeyPatch, load: Callable[[str], CorrespondenceMap]
) -> None:
    """Every network of the registry has the map that `load` gives for its weights."""
    monkeypatch.setattr("dgc_pose.matchers.load_engine", lambda weights, **options: load(weights))
    monkeypatch.setattr(
        "dgc_pose.matchers.NetworkMatcher",
        lambda dense, options, cache: MapMatcher(dense, options),
    )


def grid(columns: int, rows: int, size: tuple[int, int] = SIZE) -> np.ndarray:
    """Centres (rows, columns, 2) of the cells of an even grid over an image, pixels."""
    x = (np.arange(columns) + 0.5) * size[0] / columns - 0.5
    y = (np.arange(rows) + 0.5) * size[1] / rows - 0.5
    return np.stack(np.meshgrid(x, y), -1)


def depth_in_camera2(points2: np.ndarray) -> np.ndarray:
    """Depths (...) of the surface at (..., 2) pixels of image 2, in units of |t|."""
    x, y = np.moveaxis((points2 - K[:2, 2]) / 300.0, -1, 0)
    return 5.0 + 1.2 * np.sin(5 * x) + 0.9 * np.cos(7 * y) + 1.5 * x * y


def points_in_image1(points2: np.ndarray) -> np.ndarray:
    """The surface points at (..., 2) pixels of image 2, in pixels of image 1."""
    x, y = np.moveaxis((points2 - K[:2, 2]) / 300.0, -1, 0)
    depth = depth_in_camera2(points2)
    in_camera1 = (np.stack([x * depth, y * depth, depth], -1) - T) @ R
    return in_camera1[..., :2] / in_camera1[..., 2:] * 300.0 + K[:2, 2]


def true_map(error_px: float = 0.0) -> CorrespondenceMap:
    """The true map, exact or with a random error (one sigma); matchable inside image 1."""
    points2 = grid(CELLS, CELLS)
    noise = np.random.default_rng(0).normal(size=points2.shape)
    return make_map(points_in_image1(points2) + error_px * noise, points2)


def noise_map() -> CorrespondenceMap:
    """A random map."""
    rng = np.random.default_rng(0)
    return make_map(rng.random((CELLS, CELLS, 2)) * SIZE - 0.5, grid(CELLS, CELLS))


def make_map(
    points1: np.ndarray,
    points2: np.ndarray,
    sizes: tuple[tuple[int, int], tuple[int, int]] = (SIZE, SIZE),
    matchability: np.ndarray | float | None = None,
) -> CorrespondenceMap:
    """By (rows, columns, 2) pixels of both images; matchable inside image 1 if it is not stated."""
    if matchability is None:
        inside = ((points1 >= -0.5) & (points1 <= np.array(sizes[0]) - 0.5)).all(-1)
        matchability = np.where(inside, 0.9, 0.1)
    return CorrespondenceMap(
        map=points1.astype(np.float32),
        grid=points2.astype(np.float32),
        matchability=np.broadcast_to(matchability, points1.shape[:2]).astype(np.float32),
        size1=sizes[0],
        size2=sizes[1],
    )


def pictures(seed: int = 0) -> tuple[np.ndarray, np.ndarray]:
    """Image 1, a random texture, and image 2, the same surface from the other camera: RGB uint8."""
    rng = np.random.default_rng(seed)
    noise = rng.random((SIZE[1], SIZE[0], 3)).astype(np.float32)
    texture = sum(cv2.GaussianBlur(noise, (0, 0), sigma) * sigma for sigma in (1.2, 3.0, 8.0))
    first = cv2.normalize(texture, None, 0, 255, cv2.NORM_MINMAX).astype(np.uint8)
    x, y = np.moveaxis(points_in_image1(grid(*SIZE)).astype(np.float32), -1, 0)
    return first, cv2.remap(first, x, y, cv2.INTER_LINEAR, borderMode=cv2.BORDER_REFLECT)


def images() -> tuple[Image, Image]:
    """The pictures, as matchers take them."""
    first, second = pictures()
    return Image(first), Image(second)


def write_pictures(folder: Path) -> tuple[str, str]:
    """The pictures as PNG files: their paths."""
    paths = str(folder / "one.png"), str(folder / "two.png")
    for path, pixels in zip(paths, pictures(), strict=True):
        cv2.imwrite(path, pixels[..., ::-1])
    return paths


def write_pair_list(folder: Path, *, pairs: int = 1) -> Path:
    """The pictures and a list that names them, with the true pose, `pairs` times."""
    write_pictures(folder)
    pose = np.vstack([np.column_stack([R, 3 * T]), [0, 0, 0, 1]])
    numbers = " ".join(repr(float(v)) for part in (K, K, pose) for v in part.ravel())
    path = folder / "pairs.txt"
    path.write_text(f"one.png two.png 0 0 {numbers}\n" * pairs)
    return path
