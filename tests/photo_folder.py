"""A folder of small photographs, enough of them to train and to hold some back."""

from __future__ import annotations

from pathlib import Path

import cv2

from dgc_pose.render.procedural import procedural_textures


def write_photos(folder: Path) -> Path:
    """Write forty procedural textures of 64x64 pixels into a folder; gives the folder."""
    for index, texture in enumerate(procedural_textures(40, 64, seed=2)):
        pixels = (255 * texture.permute(1, 2, 0)).byte().numpy()
        cv2.imwrite(str(folder / f"{index}.png"), pixels[..., ::-1])
    return folder
