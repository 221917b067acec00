"""Pairs that a verdict is measured on: unrelated ones, true ones, and ones that mislead.

What a user named is looked at when a function is called; images are read pair by pair.
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Literal, get_args

import cv2
import numpy as np

from dgc_pose.benchmarks.pair_list import Pair, read_pairs
from dgc_pose.benchmarks.pairs import require_images
from dgc_pose.benchmarks.refinement import rendered_cases
from dgc_pose.camera import Camera, guess_camera
from dgc_pose.errors import InputError
from dgc_pose.image import Image, load_image
from dgc_pose.synthesis.photos import held_back_paths
from dgc_pose.synthesis.render.scene_pair import PairKind, render_scene_pair

# "turned": a camera that only turned, which has no translation to find.
CaseKind = Literal["unrelated", "true", "turned"]
Change = Literal["roll 90", "roll 180", "4x zoom", "night"]
_SUFFIXES = {".jpg", ".jpeg", ".png", ".bmp", ".ppm", ".tif", ".tiff"}
_VIEW = (800, 600)  # pixels of the views with procedural textures, and of the facade
_FLOORS, _COLUMNS = 7, 10  # windows of the facade


@dataclass(frozen=True)
class VerdictCase:
    """Two images with their cameras, what they are, and the true pose x2 = R x1 + t."""

    name: str  # the half that the pair falls in depends on it
    group: str  # a row of the table
    kind: CaseKind
    image1: Image
    image2: Image
    camera1: Camera
    camera2: Camera
    R: np.ndarray | None = None  # (3, 3); None for unrelated images
    t: np.ndarray | None = None  # (3,), any length; None for unrelated images and a mere turn


def unrelated_photos(photos: Path, count: int, seed: int) -> Iterator[VerdictCase]:
    """Pairs of different photographs, of those that training holds back, with guessed cameras.

    Raises InputError where there are not two.
    """
    paths = held_back_paths(photos)
    if len(paths) < 2:
        raise InputError(f"{photos}: {len(paths)} photographs that training holds back; need two")
    rng = np.random.default_rng(seed)
    drawn = [rng.choice(len(paths), 2, replace=False) for _ in range(count)]
    return (_unrelated("other photographs", paths[one], paths[other]) for one, other in drawn)


def unrelated_scenes(folders: Sequence[Path], count: int, seed: int) -> Iterator[VerdictCase]:
    """Pairs of photographs of two scenes; each folder holds the photographs of one.

    Raises InputError where there are not two folders with photographs.
    """
    scenes = []
    for folder in folders:
        found = sorted(p for p in folder.glob("*") if p.suffix.lower() in _SUFFIXES)
        if not found:
            raise InputError(f"{folder}: no photographs")
        scenes.append(found)
    if len(scenes) < 2:
        raise InputError("unrelated pairs need the folders of two scenes at least")
    rng = np.random.default_rng(seed)
    drawn = []
    for _ in range(count):
        one, other = rng.choice(len(scenes), 2, replace=False)
        drawn.append([scenes[k][rng.integers(len(scenes[k]))] for k in (one, other)])
    return (_unrelated("other scenes", first, second) for first, second in drawn)


def rendered(photos: Path, count: int, seed: int) -> Iterator[VerdictCase]:
    """True pairs of 5 to 40 degrees, textured with the photographs that training holds back."""
    for number, case in enumerate(rendered_cases(photos, count, seed)):
        yield VerdictCase(
            f"rendered {seed} {number}",
            "rendered, 5 to 40 deg",
            "true",
            case.image1,
            case.image2,
            case.camera1,
            case.camera2,
            case.R,
            case.t,
        )


def listed(pair_list: Path, root: Path | None, limit: int | None) -> Iterator[VerdictCase]:
    """True pairs of a list, `limit` of them at most, evenly chosen. Raises as `read_pairs` does."""
    pairs = read_pairs(pair_list, root)
    require_images(pairs)
    chosen = np.linspace(0, len(pairs) - 1, min(limit or len(pairs), len(pairs))).round()
    return (_listed(pair_list.stem, pairs[int(k)]) for k in chosen)


def misleading(photos: Path, count: int, seed: int) -> Iterator[VerdictCase]:
    """`count` pairs of each kind that misleads: planes, mere turns, forward motion, facades, and
    rendered pairs whose second view is rolled, zoomed or taken at night."""
    scenes: tuple[PairKind, ...] = ("planar", "rotation_only", "forward")
    for number in range(count):
        for scene in scenes:
            yield _scene(scene, seed + number)
        yield facade(seed + number)
    for case in rendered(photos, count, seed + 1):
        for change in get_args(Change):
            yield changed(case, change, seed)


def changed(case: VerdictCase, change: Change, seed: int) -> VerdictCase:
    """A true pair with another second view, and the pose that belongs to it."""
    R, t, camera = case.R, case.t, case.camera2
    pixels = case.image2.pixels
    if change in ("roll 90", "roll 180"):
        for _ in range(1 if change == "roll 90" else 2):
            pixels, camera, R, t = _rolled(pixels, camera, R, t)
    elif change == "4x zoom":
        height, width = pixels.shape[:2]
        x, y = 3 * width // 8, 3 * height // 8
        pixels = pixels[y : y + height // 4, x : x + width // 4]
        K = camera.K.copy()
        K[:2, 2] -= (x, y)
        camera = Camera(K, (pixels.shape[1], pixels.shape[0]))
    else:
        pixels = _night(pixels, np.random.default_rng(seed))
    image = Image(np.ascontiguousarray(pixels), f"{case.image2.name}, {change}")
    name = f"{case.name}, {change}"
    return VerdictCase(name, change, "true", case.image1, image, case.camera1, camera, R, t)


def facade(seed: int) -> VerdictCase:
    """Two views, 20 degrees apart, of a wall whose windows look alike but for their curtains."""
    rng = np.random.default_rng(seed)
    wall = _wall(rng)
    width, height = _VIEW
    K = np.array([[width, 0, (width - 1) / 2], [0, width, (height - 1) / 2], [0, 0, 1.0]])
    across = 1.6 / wall.shape[1]  # the wall is 1.6 wide and stands before the cameras at 1.2
    place = np.array(
        [
            [across, 0, -0.8],
            [0, across, -across * wall.shape[0] / 2],
            [0, 0, 1.2],
        ]
    )  # from pixels of the wall (x, y, 1) to points in the frame between the cameras
    angle = np.radians(rng.uniform(8, 12))
    poses = []
    for side in (-angle, angle):
        turn = cv2.Rodrigues(np.array([0.0, side, 0.0]))[0]
        middle = np.array([0, 0, 1.2])
        poses.append((turn, middle - turn @ middle))
    views = [
        cv2.warpPerspective(
            wall,
            K @ (turn @ place + np.outer(shift, (0, 0, 1))),
            _VIEW,
            flags=cv2.INTER_AREA,
            borderValue=(150, 180, 210),
        )
        for turn, shift in poses
    ]
    left, right = (Image(np.ascontiguousarray(view), "facade") for view in views)
    (turn1, shift1), (turn2, shift2) = poses
    R = turn2 @ turn1.T
    t = shift2 - R @ shift1
    camera = Camera(K, _VIEW)
    return VerdictCase(f"facade {seed}", "facade", "true", left, right, camera, camera, R, t)


def _unrelated(group: str, first: Path, second: Path) -> VerdictCase:
    images = load_image(first), load_image(second)
    cameras = guess_camera(first), guess_camera(second)
    name = " ".join(f"{path.parent.name}/{path.name}" for path in (first, second))
    return VerdictCase(name, group, "unrelated", *images, *cameras)


def _listed(group: str, pair: Pair) -> VerdictCase:
    name = f"{group} {pair.name1} {pair.name2}"
    images = load_image(pair.path1), load_image(pair.path2)
    return VerdictCase(name, group, "true", *images, pair.camera1, pair.camera2, pair.R, pair.t)


def _scene(scene: PairKind, seed: int) -> VerdictCase:
    pair = render_scene_pair(seed, size1=_VIEW, size2=_VIEW, rotation_deg=12.0, kind=scene)
    turned = scene == "rotation_only"
    return VerdictCase(
        f"{scene} {seed}",
        scene.replace("_", " "),
        "turned" if turned else "true",
        Image(pair.image1),
        Image(pair.image2),
        Camera(pair.K1, _VIEW),
        Camera(pair.K2, _VIEW),
        pair.R,
        None if turned else pair.t,
    )


def _rolled(
    pixels: np.ndarray, camera: Camera, R: np.ndarray | None, t: np.ndarray | None
) -> tuple[np.ndarray, Camera, np.ndarray | None, np.ndarray | None]:
    """A view turned by 90 degrees against the clock: (x, y) goes to (y, width - 1 - x)."""
    width = pixels.shape[1]
    K = camera.K
    turned = np.array(
        [[K[1, 1], 0, K[1, 2]], [0, K[0, 0], width - 1 - K[0, 2]], [0, 0, 1]], dtype=np.float64
    )
    roll = np.array([[0, 1, 0], [-1, 0, 0], [0, 0, 1.0]])
    size = (pixels.shape[0], width)
    new_R = None if R is None else roll @ R
    new_t = None if t is None else roll @ t
    return np.rot90(pixels), Camera(turned, size), new_R, new_t


def _night(pixels: np.ndarray, rng: np.random.Generator) -> np.ndarray:
    """A tenth of the light, blue, with the noise of a sensor, and lamps of a few spots."""
    light = (pixels / 255.0) ** 2.2
    height, width = light.shape[:2]
    y, x = np.mgrid[:height, :width]
    lamps = np.zeros((height, width))
    for _ in range(4):
        centre = rng.random(2) * (width, height)
        squared = (x - centre[0]) ** 2 + (y - centre[1]) ** 2
        lamps += np.exp(-squared / (2 * (0.12 * width) ** 2))
    dark = light * (0.06 * np.array([0.7, 0.8, 1.2]) + 0.25 * lamps[..., None] * (1.2, 1, 0.6))
    dark = dark + 0.004 * rng.standard_normal(dark.shape)
    return (255 * dark.clip(0, 1) ** (1 / 2.2)).round().astype(np.uint8)


def _wall(rng: np.random.Generator) -> np.ndarray:
    """A facade (H, W, 3) uint8: bricks, and a grid of windows that differ in their curtains."""
    cell = 120
    bricks = np.full((cell, cell, 3), (160, 110, 90), np.uint8)
    bricks[::12] = (190, 180, 170)
    for row in range(0, cell, 12):
        bricks[row : row + 12, (row // 12 % 2) * 12 :: 24] = (190, 180, 170)
    bricks[30:95, 35:85] = (235, 235, 230)
    bricks[34:91, 39:81] = (60, 70, 85)
    bricks[61:64, 39:81] = bricks[34:91, 59:61] = (235, 235, 230)
    wall = np.tile(bricks, (_FLOORS, _COLUMNS, 1))
    for floor in range(_FLOORS):
        for column in range(_COLUMNS):
            y, x = floor * cell, column * cell
            drawn = int(rng.integers(0, 27))
            wall[y + 34 : y + 34 + drawn, x + 39 : x + 59] = rng.integers(120, 255, 3)
            wall[y + 34 : y + 34 + drawn, x + 61 : x + 81] = rng.integers(120, 255, 3)
    grain = rng.normal(0, 6, wall.shape[:2])[..., None]
    return (wall + grain).clip(0, 255).round().astype(np.uint8)
