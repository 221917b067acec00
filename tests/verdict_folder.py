"""Folders of small photographs with nothing in common, for tests of verdicts."""

from __future__ import annotations

from pathlib import Path

import cv2
import numpy as np


def write_photos(folder: Path, count: int, seed: int = 0) -> list[Path]:
    """So many pictures of 96x80 pixels of coloured blots, each of its own."""
    rng = np.random.default_rng(seed)
    folder.mkdir()
    paths = []
    for number in range(count):
        blots = rng.integers(0, 255, (10, 12, 3)).astype(np.uint8)
        path = folder / f"photo{seed}_{number:03d}.png"
        cv2.imwrite(str(path), cv2.resize(blots, (96, 80), interpolation=cv2.INTER_CUBIC))
        paths.append(path)
    return paths
