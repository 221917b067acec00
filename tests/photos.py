"""Small photographs, drawn: in memory, or in a folder."""

from pathlib import Path

import cv2
import numpy as np
from procedural import procedural_textures

from dgc_pose.training.map_pairs import image_arrays
from dgc_pose.training.photos import Photos


def drawn_photos(count: int, side: int, places: int = 0) -> Photos:
    """So many procedural textures, squares of `side` pixels, as the trainer holds photographs, and
    places of two of them, one darker."""
    textures = image_arrays(procedural_textures(count, side, seed=1))
    return Photos.of(textures, [[texture, texture // 2] for texture in textures[:places]])


def coordinates(width: int, height: int, level: int) -> np.ndarray:
    """An image whose red and green are the pixel's x and y, and whose blue tells it apart."""
    x, y = np.meshgrid(np.arange(width), np.arange(height))
    return np.stack([x, y, np.full_like(x, level)], -1).astype(np.uint8)


def write_photos(folder: Path, count: int, seed: int = 0) -> list[Path]:
    """So many pictures of 96x80 pixels, coloured blots with nothing in common."""
    rng = np.random.default_rng(seed)
    folder.mkdir(exist_ok=True)
    paths = []
    for number in range(count):
        blots = rng.integers(0, 255, (10, 12, 3)).astype(np.uint8)
        paths.append(folder / f"photo{seed}_{number:03d}.png")
        cv2.imwrite(str(paths[-1]), cv2.resize(blots, (96, 80), interpolation=cv2.INTER_CUBIC))
    return paths
