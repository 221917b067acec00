"""Cameras with their photographs, and points, as a page that a browser shows from any side."""

import base64
import html
import json
import re
from collections.abc import Sequence
from importlib import resources
from pathlib import Path
from typing import Any, Literal

import cv2
import numpy as np

from dgc_pose.errors import ArgumentName, InputError, printable
from dgc_pose.geometry.epipolar import homogeneous
from dgc_pose.geometry.neighbours import nearest
from dgc_pose.images.image import Image, load_image, resize_by
from dgc_pose.localization.model import PosedModel, centre_of
from dgc_pose.system.threads import in_threads
from dgc_pose.trace import Trace
from dgc_pose.viz.reconstruction import mean_axes

_FILES = resources.files("dgc_pose")
_PARTS = ("page.css", "canvas.js", "scene.js")  # of `serve`, which is not imported here
_MOST, _MOST_OF_PAIR = 20_000, 3000  # points: more would slow a page down
_NEAR = 0.97  # of the points' distances that are shown: the farthest would shrink all others
_SIDE, _QUALITY = 160, 80  # longest side of a camera's photograph, pixels, and of its JPEG
_DEPTHS = 0.1, 0.18  # of a camera's pyramid, over the median distance of the points


def model_page(model: PosedModel, points: np.ndarray, colours: np.ndarray, unit: str = "") -> str:
    """A page of HTML, which loads nothing from elsewhere: a model's cameras as pyramids with their
    photographs, and its points, in the mean camera's axes.

    points: (N, 3), world; at most 20,000 are shown. colours: (N, 3) uint8, RGB. unit: of length, if
    it is known. Raises ImageError if a photograph cannot be read.
    """
    axes = mean_axes([*model.poses.values()])

    def shown(name: str) -> dict[str, Any]:
        pose, camera = model.poses[name], model.cameras[name]
        image = load_image(model.root / name).oriented(camera.orientation)
        turned = np.column_stack([pose[:, :3] @ axes.T, pose[:, 3]])
        return _camera(Path(name).stem, camera.K, image, turned)

    scene = _scene(in_threads(shown, sorted(model.poses)), points @ axes.T, colours, _MOST)
    facts = f"{len(model.poses)} cameras, {len(points)} points"
    apart = f"; cameras up to {model.extent:.3g} {unit} apart" if unit else ""
    return _page(model.root.resolve().name, facts + apart, scene)


def pose_page(trace: Trace) -> str:
    """The same of a pair: both cameras, and the inliers in camera 1's axes. Raises InputError
    without R and t."""
    names = " and ".join(Path(image.name).name for image in (trace.image1, trace.image2))
    return _page(names, f"{trace.pose.num_inliers} inliers", pose_scene(trace))


def pose_scene(trace: Trace) -> dict[str, Any]:
    """What scene.js shows of a pair, as values of JSON. Raises InputError without R and t."""
    if trace.pose.R is None or trace.pose.t is None:
        raise InputError(ArgumentName("trace"), f"has no R and t: {trace.pose.reason}")
    pose = np.column_stack([trace.pose.R, trace.pose.t])
    first = _camera("1", trace.camera1.K, trace.image1, np.eye(3, 4))
    second = _camera("2", trace.camera2.K, trace.image2, pose)
    return _scene([first, second], trace.points3d, trace.colours, _MOST_OF_PAIR)


def _camera(label: str, K: np.ndarray, image: Image, pose: np.ndarray) -> dict[str, Any]:
    """A camera: its centre and, at a depth of 1, the corners of its view from the top left on."""
    width, height = image.size
    pixels = np.array([[0, 0], [width, 0], [width, height], [0, height]]) - 0.5
    rays = homogeneous(pixels) @ np.linalg.inv(K).T @ pose[:, :3]
    small = resize_by(image.pixels, min(1.0, _SIDE / max(image.size)))
    return {
        "label": label,
        "corners": centre_of(pose) + np.vstack([np.zeros(3), rays]),
        "photograph": picture_url(small, "jpeg", cv2.IMWRITE_JPEG_QUALITY, _QUALITY),
    }


def _scene(
    cameras: Sequence[dict[str, Any]], points: np.ndarray, colours: np.ndarray, most: int
) -> dict[str, Any]:
    """The cameras, as deep as their distances allow, and points in a random order."""
    centres = np.stack([camera["corners"][0] for camera in cameras])
    depth = float(np.median(nearest(centres, 2)[0][:, 1])) or 1.0
    away = np.linalg.norm(points - centres.mean(0), axis=1)
    chosen = np.flatnonzero(np.isfinite(away))
    if len(chosen):
        depth = float(np.clip(depth, *np.multiply(_DEPTHS, np.median(away[chosen]))))
        chosen = chosen[away[chosen] <= np.quantile(away[chosen], _NEAR)]
    chosen = np.random.default_rng(0).permutation(chosen)[:most]
    digits = 4 - int(np.floor(np.log10(depth)))
    for camera, centre in zip(cameras, centres, strict=True):
        corners = centre + depth * (camera["corners"] - centre)
        camera["corners"] = corners.round(digits).tolist()
    xyz, rgb = points[chosen].round(digits).tolist(), colours[chosen].tolist()
    return {"cameras": cameras, "points": {"xyz": xyz, "rgb": rgb}}


def _page(title: str, facts: str, scene: dict[str, Any]) -> str:
    """The page with all that it is made of: text, style sheet, scripts and the scene."""
    parts = {"title": html.escape(printable(title)), "facts": html.escape(facts)}
    for name in _PARTS:
        text = (_FILES / "serve" / "static" / name).read_text(encoding="utf-8")
        parts[name] = re.sub(r"^(import .*$|export )", "", text, flags=re.MULTILINE)
    parts["content"] = json.dumps(scene).replace("<", r"\u003c")
    page = (_FILES / "viz" / "model.html").read_text(encoding="utf-8")
    return re.sub(r"{{(.*?)}}", lambda match: parts[match[1]], page)


def picture_url(pixels: np.ndarray, kind: Literal["jpeg", "webp"], *settings: int) -> str:
    """An image (H, W, 3 or 4) uint8, RGB or RGBA, as text that a page shows."""
    order = [2, 1, 0, 3][: pixels.shape[2]]
    done, data = cv2.imencode(f".{kind}", np.ascontiguousarray(pixels[..., order]), list(settings))
    assert done
    return f"data:image/{kind};base64,{base64.b64encode(data.tobytes()).decode()}"
