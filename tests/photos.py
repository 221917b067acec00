"""Small photographs, drawn: in memory, or in a folder."""

from pathlib import Path

import cv2
import numpy as np
import torch
from procedural import procedural_textures

from dgc_pose.training.synthesis.photos import Photos


def drawn_photos(count: int, side: int) -> Photos:
    """So many procedural textures, squares of `side` pixels, as the trainer holds photographs."""
    return Photos.of((255 * procedural_textures(count, side, seed=1)).round().to(torch.uint8))


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
