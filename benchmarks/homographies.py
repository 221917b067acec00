"""Pairs of images that a known homography relates, read from folders, and their true maps.

A matrix H maps pixels of the first image to the second, x2 ~ H x1. The layouts are HPatches'
sequences of a changing viewpoint (`v_*`), VGG's affine-covariant sets, and annotated pairs.
"""

from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path

import numpy as np
import torch

from dgc_pose.benchmarks.map_run import MapCase, MapSet
from dgc_pose.errors import InputError
from dgc_pose.files.inputs import read_as, read_text
from dgc_pose.geometry.pixels import pixel_grid
from dgc_pose.images.image import load_image, resize
from dgc_pose.network.config import INPUT_SIZE
from dgc_pose.training.views import MapPairs

VIEWPOINTS = ("I", "II", "III", "IV", "V")  # of images 2 to 6 of a sequence, seen from image 1
_SUFFIXES = (".ppm", ".png", ".jpg", ".jpeg", ".pgm")
_MATRIX_BYTES = 2**16  # of a file with nine numbers
SEQUENCES = 59  # of a changing viewpoint in HPatches
_FAR = 1e6  # pixels, coordinate of a map's points beyond the horizon


@dataclass(frozen=True, eq=False)
class HomographyPair:
    """Two images of a plane. Image 1 is the source, image 2 the target."""

    name: str
    group: str  # that its figures are averaged in: a viewpoint of HPatches, or the folder
    path1: Path
    path2: Path
    H: np.ndarray  # (3, 3) float64, x2 ~ H x1, pixels of the images as stored


def homography_set(root: str | Path) -> MapSet:
    """All pairs of the three layouts in a folder and the folders right below it, read one by one.

    Raises InputError if there is no pair or, with the path, if a matrix is malformed.
    """
    pairs = find_homography_pairs(Path(root))
    found = {pair.path1.parent for pair in pairs if pair.group in VIEWPOINTS}
    title = f"{len(pairs)} pairs of {root}, {len(found)} of HPatches' {SEQUENCES} sequences"
    cases = (MapCase(pair.group, (pair.name,), load_pair(pair)) for pair in pairs)
    return MapSet(cases, len(pairs), {"root": str(root), "sequences": len(found)}, title)


def find_homography_pairs(root: Path) -> list[HomographyPair]:
    """The pairs of a folder whose files are all there. Raises as `homography_set` does."""
    folders = [root, *sorted(path for path in root.iterdir() if path.is_dir())]
    pairs = [pair for folder in folders for pair in _pairs_in(folder)]
    if not pairs:
        raise InputError(
            f"{root}: no pairs; expected HPatches (v_*/1.ppm, v_*/H_1_2), VGG's sets (img1.ppm, "
            f"H1to2p) or annotated pairs (NAME_A.jpg, NAME_B.jpg, NAME_H.txt)"
        )
    return pairs


def load_pair(pair: HomographyPair) -> MapPairs:
    """A batch of the one pair at 240x240 with its true map.

    Raises ImageError for an image that cannot be read.
    """
    image1, image2 = load_image(pair.path1), load_image(pair.path2)
    points, valid = true_map(pair.H, image1.size, image2.size)
    truth = points.astype(np.float32)
    squares = (resize(image.pixels, (INPUT_SIZE, INPUT_SIZE)) for image in (image1, image2))
    source, target = (torch.from_numpy(s).permute(2, 0, 1)[None].float() / 255 for s in squares)
    parts = (truth, valid, np.ones_like(valid))
    return MapPairs(source, target, *(torch.from_numpy(part)[None] for part in parts))


def true_map(
    H: np.ndarray, size1: tuple[int, int], size2: tuple[int, int]
) -> tuple[np.ndarray, np.ndarray]:
    """The map of a homography between images that are squared to 240 x 240 pixels.

    H: (3, 3), x2 ~ H x1 in pixels of images of size1 and size2, (width, height). Returns the map
    (240, 240, 2) float64, for each pixel of the squared target a point of the squared source, and
    a mask (240, 240) of valid pixels: both coordinates within 0 and 239, which is [-1, 1] in the
    paper's normalised coordinates. Squaring follows the half-pixel rule.
    """
    cells = INPUT_SIZE
    squared = _squaring(size2) @ H @ np.linalg.inv(_squaring(size1))
    # The scale of H decides the sign of the depth alone: positive at the source's centre.
    centre = np.array([(cells - 1) / 2, (cells - 1) / 2, 1.0])
    inverse = np.linalg.inv(squared * np.sign((squared @ centre)[2] or 1.0))
    pixels = pixel_grid((cells, cells))
    source = np.concatenate([pixels, np.ones((cells, cells, 1))], -1) @ inverse.T
    ahead = source[..., 2] > 0
    depth = np.where(ahead, source[..., 2], 1.0)
    truth = np.where(ahead[..., None], source[..., :2] / depth[..., None], _FAR)
    valid = ahead & ((truth >= 0) & (truth <= cells - 1)).all(-1)
    return np.clip(truth, -_FAR, _FAR), valid


def read_matrix(path: Path) -> np.ndarray:
    """A homography from a text file. Raises InputError, with the path, if it is malformed."""
    with read_as("a homography", path):
        words = read_text(path, "a homography", _MATRIX_BYTES).split()
        H = np.array(words, np.float64).reshape(3, 3)
        if not np.isfinite(H).all() or np.linalg.matrix_rank(H) < 3:
            raise ValueError("a homography has finite numbers and an inverse")
    return H


def _squaring(size: tuple[int, int]) -> np.ndarray:
    """(3, 3), from pixels of an image of `size` to those of the square, by the half-pixel rule."""
    sx, sy = np.divide(INPUT_SIZE, size)
    return np.array([[sx, 0, (sx - 1) / 2], [0, sy, (sy - 1) / 2], [0, 0, 1]])


def _pairs_in(folder: Path) -> Iterator[HomographyPair]:
    """The pairs right in a folder, in each of the layouts."""
    name, found = folder.resolve().name, []  # name and group of a pair, its images and its matrix
    for k, viewpoint in enumerate(VIEWPOINTS, start=2):
        if folder.name.startswith("v_"):
            found.append((f"{name} 1-{k}", viewpoint, "1", f"{k}", f"H_1_{k}"))
        found.append((f"{name} 1-{k}", name, "img1", f"img{k}", f"H1to{k}p"))
    for matrix in sorted(folder.glob("*_H.txt")):
        stem = matrix.name.removesuffix("_H.txt")
        found.append((f"{name}/{stem}", name, f"{stem}_A", f"{stem}_B", matrix.name))
    for pair, group, stem1, stem2, matrix_name in found:
        path1, path2 = _image(folder / stem1), _image(folder / stem2)
        matrix = folder / matrix_name
        if path1 is not None and path2 is not None and matrix.is_file():
            yield HomographyPair(pair, group, path1, path2, read_matrix(matrix))


def _image(stem: Path) -> Path | None:
    """The image file of that name, whatever its suffix."""
    paths = (stem.with_name(stem.name + suffix) for suffix in _SUFFIXES)
    return next((path for path in paths if path.is_file()), None)
