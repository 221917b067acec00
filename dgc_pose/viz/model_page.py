"""Cameras with their photographs, and points, as a page that a browser shows from any side."""

import base64
import json
import re
from collections.abc import Sequence
from importlib import resources
from pathlib import Path
from typing import Any, Literal

import cv2
import numpy as np

from dgc_pose.errors import ArgumentName, InputError
from dgc_pose.geometry.epipolar import homogeneous
from dgc_pose.geometry.neighbours import nearest
from dgc_pose.images.image import Image, load_image, resize_by
from dgc_pose.localization.model import PosedModel, centre_of
from dgc_pose.system.threads import in_threads
from dgc_pose.trace import Trace
from dgc_pose.viz.reconstruction import mean_axes

_STATIC = resources.files("dgc_pose") / "serve" / "static"  # files alone, no import
_MOST, _MOST_OF_PAIR = 20_000, 3000  # points: more would slow a page down
_NEAR = 0.97  # of the points' distances that are shown: the farthest would shrink all others
_SIDE, _QUALITY = 160, 80  # longest side of a camera's picture, pixels, and of its JPEG
_DEPTHS = 0.1, 0.18  # least and most depth of a camera's pyramid, over the points' distance


def model_page(model: PosedModel, points: np.ndarray, colours: np.ndarray, unit: str = "") -> str:
    """A page of HTML with a model's cameras, as pyramids with their photographs, and its points, in
    the mean camera's axes. It loads nothing from elsewhere.

    points: (N, 3), world; at most 20,000 are shown. colours: (N, 3) uint8, RGB. unit: of length,
    for a scale bar; without one there is none. Raises ImageError if a photograph cannot be read.
    """
    axes = mean_axes([*model.poses.values()])[2]

    def camera(name: str) -> dict[str, Any]:
        pose, camera = model.poses[name], model.cameras[name]
        image = load_image(model.root / name).oriented(camera.orientation)
        turned = np.column_stack([pose[:, :3] @ axes.T, pose[:, 3]])
        return _camera(Path(name).stem, "camera1", camera.K, image, turned, pictured=True)

    cameras = in_threads(camera, sorted(model.poses))
    facts = f"{len(cameras)} cameras, {len(points)} points"
    scene = _scene(cameras, points @ axes.T, colours, _MOST)
    return _page(model.root.resolve().name, facts, {**scene, "unit": unit})


def pose_page(trace: Trace) -> str:
    """The same of a pair: both cameras and the inliers, in camera 1's axes; the unit of length is
    the distance between the cameras. Raises InputError without a pose."""
    scene = pose_scene(trace, pictured=True)
    if scene is None:
        raise InputError(ArgumentName("trace"), f"has no pose: {trace.pose.reason}")
    names = " and ".join(Path(image.name).name for image in (trace.image1, trace.image2))
    return _page(names, f"{trace.pose.num_inliers} inliers", scene)


def pose_scene(trace: Trace, *, pictured: bool = False) -> dict[str, Any] | None:
    """What scene.js draws of a pair, as values of JSON; None without R and t."""
    if trace.pose.R is None or trace.pose.t is None:
        return None
    pose = np.column_stack([trace.pose.R, trace.pose.t])
    first = _camera("1", "camera1", trace.camera1.K, trace.image1, np.eye(3, 4), pictured=pictured)
    second = _camera("2", "camera2", trace.camera2.K, trace.image2, pose, pictured=pictured)
    return _scene([first, second], trace.points3d, trace.colours, _MOST_OF_PAIR)


def _camera(
    label: str, colour: str, K: np.ndarray, image: Image, pose: np.ndarray, *, pictured: bool
) -> dict[str, Any]:
    """A camera, its corners at a depth of 1, seen from its centre; clockwise from the top left."""
    width, height = image.size
    corners = np.array([[0, 0], [width, 0], [width, height], [0, height]]) - 0.5
    rays = homogeneous(corners) @ np.linalg.inv(K).T @ pose[:, :3]
    camera = {"label": label, "colour": colour, "centre": centre_of(pose), "corners": rays}
    if pictured:
        small = resize_by(image.pixels, min(1.0, _SIDE / max(image.size)))
        camera["picture"] = picture_url(small, "jpeg", cv2.IMWRITE_JPEG_QUALITY, _QUALITY)
    return camera


def _scene(
    cameras: Sequence[dict[str, Any]], points: np.ndarray, colours: np.ndarray, most: int
) -> dict[str, Any]:
    """What scene.js draws: all cameras, and points in a random order, without the farthest."""
    centres = np.stack([camera["centre"] for camera in cameras])
    apart = float(np.median(nearest(centres, 2)[0][:, 1])) or 1.0
    away = np.linalg.norm(points - centres.mean(0), axis=1)
    finite = np.flatnonzero(np.isfinite(away))
    shown, least, largest = finite, apart, apart
    if len(finite):
        shown = finite[away[finite] <= np.quantile(away[finite], _NEAR)]
        least, largest = np.multiply(_DEPTHS, np.median(away[finite]))
    depth = np.clip(apart, least, largest)
    shown = np.random.default_rng(0).permutation(shown)[:most]
    digits = 4 - int(np.floor(np.log10(depth)))
    for camera, centre in zip(cameras, centres, strict=True):
        camera["corners"] = (centre + depth * camera["corners"]).round(digits).tolist()
        camera["centre"] = centre.round(digits).tolist()
    dots = {"xyz": points[shown].round(digits).tolist(), "rgb": colours[shown].tolist()}
    return {"cameras": cameras, "points": dots}


def _page(title: str, facts: str, content: dict[str, Any]) -> str:
    """The page: the style sheet, the scripts and the content stand in it."""
    style, page, *scripts = (
        (_STATIC / name).read_text(encoding="utf-8")
        for name in ("page.css", "model.html", "canvas.js", "scene.js")
    )
    script = re.sub(r"^(import .*$|export )", "", "".join(scripts), flags=re.MULTILINE)
    data = json.dumps({"title": title, "facts": facts, **content}).replace("<", r"\u003c")
    for name, text in (("style", style), ("script", script), ("model", data)):
        page = page.replace(f"{{{{{name}}}}}", text)
    return page


def picture_url(pixels: np.ndarray, kind: Literal["jpeg", "webp"], *settings: int) -> str:
    """An image (H, W, 3 or 4) uint8, RGB or RGBA, as text that a page shows."""
    order = [2, 1, 0, 3][: pixels.shape[2]]
    done, data = cv2.imencode(f".{kind}", np.ascontiguousarray(pixels[..., order]), list(settings))
    assert done
    return f"data:image/{kind};base64,{base64.b64encode(data.tobytes()).decode()}"
