"""Pairs of DTU views with a chosen rotation and overlap, drawn at random from the calibration."""

from collections.abc import Sequence
from dataclasses import dataclass
from functools import cache
from itertools import combinations, groupby
from pathlib import Path

import numpy as np

from dgc_pose.benchmarks.dtu.dataset import DtuScene, DtuView, relative_pose
from dgc_pose.cameras.camera import Camera
from dgc_pose.cameras.pair_list import Pair
from dgc_pose.errors import InputError
from dgc_pose.metrics import rotation_error_deg
from dgc_pose.system.options import MAX_SEED, check_options, option

_LEAST_BASELINE_MM = 1e-3  # what rounding leaves between two centres that are the same
_BINS = 7  # equal rotation bins, drawn from in turn
_DEPTHS_MM = (425.0, 935.0)  # the depths between which DTU's objects stand in every view
_GRID = (16, 12, 8)  # columns, rows and depths of the point set that fills a view


@dataclass(frozen=True)
class ViewPairOptions:
    """Which pairs to draw. Raises InputError, naming the field, on a value out of range."""

    pairs: int = option(64, "How many pairs to draw, over all scenes.", min=1, max=10**7)
    min_rotation: float = option(5.0, "Smallest relative rotation, degrees.", min=0, max=180)
    max_rotation: float = option(40.0, "Largest relative rotation, degrees.", min=0, max=180)
    min_overlap: float = option(
        0.4, "Least share of the space at DTU's depths that both views see.", min=0, max=1
    )
    seed: int = option(0, "The same seed, the same list.", min=0, max=MAX_SEED)

    def __post_init__(self) -> None:
        check_options(self)
        if not self.min_rotation < self.max_rotation:
            raise InputError(
                "min_rotation must be below max_rotation, "
                f"not {self.min_rotation:g} and {self.max_rotation:g}"
            )


@dataclass(frozen=True)
class ViewPair:
    """Two views of a scene, and their relative rotation by the calibration."""

    scene: DtuScene
    view1: int
    view2: int
    rotation_deg: float


def find_view_pairs(scenes: Sequence[DtuScene], options: ViewPairOptions) -> list[ViewPair]:
    """All pairs of views (the smaller number first) within the rotation and overlap asked for."""
    pairs = []
    for scene in scenes:
        for view1, view2 in combinations(sorted(scene.views), 2):
            motion = _motion(scene.views[view1], scene.views[view2], scene.size)
            rotation_deg, shared, baseline_mm = motion
            if (
                options.min_rotation <= rotation_deg <= options.max_rotation
                and shared >= options.min_overlap
                and baseline_mm > _LEAST_BASELINE_MM
            ):
                pairs.append(ViewPair(scene, view1, view2, rotation_deg))
    return pairs


def draw(candidates: Sequence[ViewPair], options: ViewPairOptions) -> list[ViewPair]:
    """Draw pairs at random: from each scene in turn, and within a scene from each rotation bin.

    candidates: scene by scene. The pairs are balanced over scenes, and those of a scene over the
    rotations. The same seed draws the same pairs, scene by scene; fewer than asked for only if
    there are fewer candidates.
    """
    rng = np.random.default_rng(options.seed)
    ranked = []
    for scene, pairs in groupby(candidates, lambda pair: pair.scene.number):
        spread = _spread_over_rotations(list(pairs), options, rng)
        ranked += [(rank, scene, pair) for rank, pair in enumerate(spread)]
    drawn = sorted(ranked, key=lambda entry: entry[:2])[: options.pairs]
    return [pair for _, _, pair in sorted(drawn, key=lambda entry: (entry[1], entry[0]))]


def listed_pair(root: Path, pair: ViewPair) -> Pair:
    """Images, cameras and true pose (t in millimetres), for a pair list. root: of the data set."""
    scene, numbers = pair.scene, (pair.view1, pair.view2)
    view1, view2 = (scene.views[number] for number in numbers)
    name1, name2 = (scene.images[number].relative_to(root).as_posix() for number in numbers)
    camera1, camera2 = (Camera(K=view.K, size=scene.size) for view in (view1, view2))
    return Pair(name1, name2, root, camera1, camera2, *relative_pose(view1, view2))


def overlap(view1: DtuView, view2: DtuView, size: tuple[int, int]) -> float:
    """The share of points seen by both views, 0 to 1, the same in either order.

    size: (width, height) of both images, pixels.

    Each view's frustum between the depths of DTU's objects is filled with points, and the share of
    all the points of both frusta that project into the other image is taken.
    """
    return (_share_seen(view1, view2, size) + _share_seen(view2, view1, size)) / 2


@cache  # in some layouts all scenes share their views
def _motion(view1: DtuView, view2: DtuView, size: tuple[int, int]) -> tuple[float, float, float]:
    """Rotation, degrees, overlap and baseline, mm."""
    R, t = relative_pose(view1, view2)
    rotation_deg = rotation_error_deg(R, np.eye(3))
    return rotation_deg, overlap(view1, view2, size), float(np.linalg.norm(t))


def _spread_over_rotations(
    pairs: Sequence[ViewPair], options: ViewPairOptions, rng: np.random.Generator
) -> list[ViewPair]:
    """All of them in random order, but one from each rotation bin in turn."""
    edges = np.linspace(options.min_rotation, options.max_rotation, _BINS + 1)
    bins = np.digitize([pair.rotation_deg for pair in pairs], edges[1:-1])
    queues: list[list[ViewPair]] = [[] for _ in range(_BINS)]
    for pair, number in zip(pairs, bins, strict=True):
        queues[number].append(pair)
    for queue in queues:
        rng.shuffle(queue)
    spread: list[ViewPair] = []
    while len(spread) < len(pairs):
        spread.extend(queue.pop() for queue in queues if queue)
    return spread


def _share_seen(view1: DtuView, view2: DtuView, size: tuple[int, int]) -> float:
    """The share of points in front of view 1 that project into the image of view 2."""
    width, height = size
    R, t = relative_pose(view1, view2)
    projected = (_frustum_points(view1, size) @ R.T + t) @ view2.K.T
    depth = projected[:, 2]
    # An edge of the image is half a pixel beyond the centre of its outermost pixels.
    x, y = projected[:, 0] + 0.5 * depth, projected[:, 1] + 0.5 * depth
    inside = (depth > 0) & (x >= 0) & (x <= width * depth) & (y >= 0) & (y <= height * depth)
    return float(inside.mean())


def _frustum_points(view: DtuView, size: tuple[int, int]) -> np.ndarray:
    """Points (N, 3) in the camera's axes that fill its image evenly, at every depth, mm."""
    columns, rows, depths = _GRID
    x = (np.arange(columns) + 0.5) / columns * size[0] - 0.5
    y = (np.arange(rows) + 0.5) / rows * size[1] - 0.5
    z = np.linspace(*_DEPTHS_MM, depths)
    pixels = np.stack([axis.ravel() for axis in (*np.meshgrid(x, y), np.ones((rows, columns)))])
    rays = np.linalg.solve(view.K, pixels)
    return (rays[:, None, :] * z[None, :, None]).reshape(3, -1).T
