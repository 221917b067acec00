"""Render the bundled demo pair (dgc_pose/data/demo): `python tests/render_demo.py OUT_DIR`."""

from __future__ import annotations

import sys
from pathlib import Path

import numpy as np
from demo_scene import demo_scene, demo_textures
from PIL import Image

from dgc_pose.synthesis.options import SceneOptions
from dgc_pose.synthesis.render.overlap import Candidate
from dgc_pose.synthesis.render.rendered_pairs import render_views
from dgc_pose.synthesis.render.scene_pair import RenderedPair, as_arrays

IMAGE_NAMES = ("image1.jpg", "image2.jpg")
LIST_NAME = "pair.txt"
_JPEG_QUALITY = 90
_LIGHTING = SceneOptions(shading=0.45, shadow=0.4)


def render_demo(*, supersample: int = 2) -> RenderedPair:
    """The demo pair with its exact geometry; metres."""
    views = Candidate(*demo_scene())
    lights = views.scene.light, views.scene.light
    return as_arrays(render_views(views, demo_textures(), lights, _LIGHTING, supersample))


def pair_line(pair: RenderedPair) -> str:
    """The pair in SuperGlue's format: names, two zeros, K1, K2, and cam2_from_cam1 as 4x4."""
    pose = np.eye(4)
    pose[:3, :3], pose[:3, 3] = pair.R, pair.t
    numbers = np.concatenate([matrix.ravel() for matrix in (pair.K1, pair.K2, pose)])
    return " ".join((*IMAGE_NAMES, "0", "0", *(f"{number:.12g}" for number in numbers)))


def write_demo(folder: Path) -> None:
    """Write both images and the pair list into `folder`."""
    pair = render_demo()
    folder.mkdir(parents=True, exist_ok=True)
    for name, image in zip(IMAGE_NAMES, (pair.image1, pair.image2), strict=True):
        Image.fromarray(image).save(folder / name, quality=_JPEG_QUALITY)
    (folder / LIST_NAME).write_text(pair_line(pair) + "\n")


if __name__ == "__main__":
    if len(sys.argv) != 2:
        sys.exit("usage: python tests/render_demo.py OUT_DIR")
    write_demo(Path(sys.argv[1]))
