"""Small photographs, drawn: in memory, or a folder of enough to train and to hold some back."""

from __future__ import annotations

from pathlib import Path

import cv2
import torch

from dgc_pose.synthesis.photos import Photos
from dgc_pose.synthesis.render.procedural import procedural_textures


def drawn_photos(count: int, side: int) -> Photos:
    """So many procedural textures, squares of `side` pixels, as the trainer holds photographs."""
    return Photos.of((255 * procedural_textures(count, side, seed=1)).round().to(torch.uint8))


def write_photos(folder: Path) -> Path:
    """Write forty procedural textures of 64x64 pixels into a folder; gives the folder."""
    for index, texture in enumerate(procedural_textures(40, 64, seed=2)):
        pixels = (255 * texture.permute(1, 2, 0)).byte().numpy()
        cv2.imwrite(str(folder / f"{index}.png"), pixels[..., ::-1])
    return folder
