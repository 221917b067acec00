"""Cameras with their photographs, and points, as a page that a browser shows from any side."""

import html
import json
import re
from collections.abc import Collection, Sequence
from importlib import resources
from pathlib import Path
from typing import Any

import cv2
import numpy as np

from dgc_pose.errors import printable
from dgc_pose.images.image import Image, load_image, picture_url, resize_by
from dgc_pose.model import Model
from dgc_pose.pair_result import PairResult
from dgc_pose.scene import frustum, mean_axes, pose_scene, scene_of
from dgc_pose.system.parallel import in_threads

_FILES = resources.files("dgc_pose")
_PARTS = ("page.css", "canvas.js", "scene.js")  # of `serve`, which is not imported here
_SIDE, _QUALITY = 160, 80  # longest side of a camera's photograph, pixels, and of its JPEG
_MOST = 20_000  # points: more would slow a page down


def model_page(model: Model, unit: str = "", turned_down: Collection[tuple[str, str]] = ()) -> str:
    """A page of HTML, which loads nothing from elsewhere: a model's cameras as pyramids with their
    photographs, and its points, at most 20,000, in the mean camera's axes.

    unit: of length, if it is known. turned_down: names of pairs that do not hold in the folder,
    between whose cameras dashed lines are drawn. Raises ImageError if a photograph cannot be read.
    """
    names, axes = sorted(model.poses), mean_axes([*model.poses.values()])

    def shown(name: str) -> tuple[np.ndarray, str]:
        pose, camera = model.poses[name], model.cameras[name]
        image = load_image(model.root / name)
        turned = np.column_stack([pose[:, :3] @ axes.T, pose[:, 3]])
        return frustum(camera.K, image.size, turned), _thumbnail(image)

    frusta, photographs = zip(*in_threads(shown, names), strict=True)
    labels = [Path(name).stem for name in names]
    scene = scene_of(labels, np.stack(frusta), model.points @ axes.T, model.colours, _MOST)
    place = {name: number for number, name in enumerate(names)}
    pairs = [(place[a], place[b]) for a, b in turned_down if a in place and b in place]
    scene["turned_down"] = pairs
    facts = f"{len(model.poses)} cameras, {len(model.points)} points"
    if pairs:
        facts += f"; dashed: {len(pairs)} pair{'s' * (len(pairs) > 1)} that the folder turns down"
    apart = f"; cameras up to {model.extent:.3g} {unit} apart" if unit else ""
    return _page(model.root.resolve().name, facts + apart, scene, photographs)


def pose_page(result: PairResult) -> str:
    """The same of a pair: both cameras, and the inliers in camera 1's axes. Raises InputError
    without R and t."""
    scene, images = pose_scene(result), (result.image1, result.image2)
    names = " and ".join(Path(image.name).name for image in images)
    return _page(names, f"{result.pose.num_inliers} inliers", scene, [*map(_thumbnail, images)])


def _thumbnail(image: Image) -> str:
    """A small copy of a photograph, as a URL."""
    small = resize_by(image.pixels, min(1.0, _SIDE / max(image.size)))
    return picture_url(small, "jpeg", cv2.IMWRITE_JPEG_QUALITY, _QUALITY)


def _page(title: str, facts: str, scene: dict[str, Any], photographs: Sequence[str]) -> str:
    """The page with all that it is made of: text, style sheet, scripts and the scene, whose cameras
    have these photographs."""
    for camera, photograph in zip(scene["cameras"], photographs, strict=True):
        camera["photograph"] = photograph
    parts = {"title": html.escape(printable(title)), "facts": html.escape(facts)}
    for name in _PARTS:
        text = (_FILES / "serve" / "static" / name).read_text(encoding="utf-8")
        parts[name] = re.sub(r"^(import .*$|export )", "", text, flags=re.MULTILINE)
    parts["content"] = json.dumps(scene).replace("<", r"\u003c")
    page = (_FILES / "viz" / "model.html").read_text(encoding="utf-8")
    return re.sub(r"{{(.*?)}}", lambda match: parts[match[1]], page)
