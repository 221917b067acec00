"""An HTML page with a 3D view of cameras with their photographs, and points."""

import html
import json
import re
from collections.abc import Collection, Sequence
from dataclasses import replace
from importlib import resources
from pathlib import Path
from typing import Any

import cv2
import numpy as np

from dgc_pose.cameras.camera import Camera
from dgc_pose.errors import ArgumentName, InputError, printable, shortened
from dgc_pose.geometry.epipolar import homogeneous
from dgc_pose.geometry.rotation import aligning_rotation
from dgc_pose.geometry.sampling import nearest
from dgc_pose.images.image import Image, load_image, picture_url, resize_by
from dgc_pose.model import Model
from dgc_pose.pose import PairResult
from dgc_pose.system.parallel import in_threads

_FILES = resources.files("dgc_pose")
_PARTS = ("page.css", "canvas.js", "scene.js")  # files of `serve`, which is not imported here
_SIDES = 160, 960  # of a photograph's copy: range of the longest side, pixels
_PIXELS = 16_000_000  # of all copies together, squares of their longest sides: some 5 MB
_QUALITY = 80  # of a copy's JPEG
# Points; more would slow a page down
_MOST = 20_000
_MOST_OF_PAIR = 3000
_NEAR = 0.97  # quantile of the points' distances; farther points would shrink all others
_DEPTHS = 0.1, 0.18  # range of the depth of a camera's pyramid over the points' median distance
# Factors of the depths of a rig's pyramids
_FIXED = 1.2
_WALK = 0.4


def model_page(
    model: Model,
    unit: str = "",
    rejected: Collection[tuple[str, str]] = (),
    cameras: Path | None = None,
) -> str:
    """Make a self-contained HTML page of a model: its cameras as pyramids with their photographs,
    and at most 20,000 of its points, in the axes of the mean camera.

    unit: of length, or "" if unknown. rejected: names of pairs rejected as look-alikes, shown as
    dashed lines between their cameras. cameras: of a rig, the folder of the fixed cameras'
    pictures, shown bold with their names; all other images are the walk, shown thin. Raises
    ImageError if a photograph cannot be read.
    """
    names = sorted(model.poses)
    axes = mean_axes([*model.poses.values()])
    fixed = _inside(model, cameras) if cameras else []
    side = _side(len(names) - len(fixed))

    def shown(name: str) -> tuple[np.ndarray, str]:
        pose = model.poses[name]
        camera = model.cameras[name]
        image = load_image(model.root / name)
        turned = np.column_stack([pose[:, :3] @ axes.T, pose[:, 3]])
        copy = _copy(image, _SIDES[1] if name in fixed else side)
        return frustum(camera.K, image.size, turned), copy

    frusta, photographs = zip(*in_threads(shown, names), strict=True)
    labels = [Path(name).stem for name in names]
    sizes = np.array([_FIXED if name in fixed else _WALK for name in names]) if fixed else 1.0
    points = model.points @ axes.T
    scene = scene_of(labels, np.stack(frusta), points, model.colours, _MOST, sizes)
    place = {name: number for number, name in enumerate(names)}
    scene["rejected"] = [(place[a], place[b]) for a, b in rejected if a in place and b in place]
    for name, camera, photograph in zip(names, scene["cameras"], photographs, strict=True):
        camera["photograph"] = photograph
        camera["facts"] = _facts(model, name, unit)
        if fixed:
            camera["kind"] = "fixed" if name in fixed else "walk"
    title = shortened(", ".join(Path(name).stem for name in fixed)) or model.root.resolve().name
    return _page(title, _summary(model, unit, fixed, len(scene["rejected"])), scene)


def pose_page(result: PairResult) -> str:
    """Make the page of a pair: the two cameras and the inliers, in the axes of camera 1. Raises
    InputError without R and t."""
    scene = pose_scene(result)
    images = (result.image1, result.image2)
    names = [Path(image.name).name for image in images]
    cameras = (result.camera1, result.camera2)
    views = zip(scene["cameras"], images, cameras, names, strict=True)
    for shown, image, camera, name in views:
        shown["photograph"] = _copy(image, _SIDES[1])
        shown["facts"] = f"{name}, {_optics(camera, image.size)}"
    return _page(" and ".join(names), f"{result.pose.num_inliers} inliers", scene)


def _inside(model: Model, folder: Path) -> list[str]:
    where = folder.resolve()
    return sorted(name for name in model.poses if (model.root / name).parent.resolve() == where)


def _side(count: int) -> int:
    """The longest side of the copies of so many photographs, pixels."""
    return int(np.clip((_PIXELS / max(count, 1)) ** 0.5, *_SIDES))


def _copy(image: Image, side: int) -> str:
    """A copy of a photograph, at most `side` pixels long, as a data URL."""
    small = resize_by(image.pixels, min(1.0, side / max(image.size)))
    return picture_url(small, "jpeg", cv2.IMWRITE_JPEG_QUALITY, _QUALITY)


def _facts(model: Model, name: str, unit: str) -> str:
    """Where a camera of a model is, in the model's axes, and its optics."""
    centre = ", ".join(f"{value:.4g}" for value in model.centre(name))
    camera = model.cameras[name]
    return f"centre ({centre}) {unit}".rstrip() + f", {_optics(camera, camera.size)}"


def _optics(camera: Camera, size: tuple[int, int] | None) -> str:
    pixels = "" if size is None else f", {size[0]} x {size[1]} pixels"
    return f"f = {camera.focal:.1f} px{pixels}"


def _summary(model: Model, unit: str, fixed: Sequence[str], rejected: int) -> str:
    """A line about a model. fixed: names of the fixed cameras' pictures. rejected: number of pairs
    rejected as look-alikes."""
    walk = len(model.poses) - len(fixed)
    cameras = f"{walk} cameras"
    extent = model.extent
    if fixed:
        cameras = f"{len(fixed)} fixed camera{'s' * (len(fixed) != 1)}" + (
            f", a walk of {walk}" if walk else ""
        )
        extent = replace(model, poses={name: model.poses[name] for name in fixed}).extent
    facts = [f"{cameras}, {len(model.points)} points"]
    if rejected:
        facts.append(f"dashed: {rejected} pair{'s' * (rejected > 1)} rejected as look-alikes")
    if unit and extent:
        facts.append(f"cameras up to {extent:.3g} {unit} apart")
    return "; ".join(facts)


def _page(title: str, facts: str, scene: dict[str, Any]) -> str:
    """Fill the page's template with text, style sheet, scripts and the scene, whose cameras have
    photographs as data URLs."""
    parts = {"title": html.escape(printable(title)), "facts": html.escape(facts)}
    for name in _PARTS:
        text = (_FILES / "serve" / "static" / name).read_text(encoding="utf-8")
        parts[name] = re.sub(r"^(import .*$|export )", "", text, flags=re.MULTILINE)
    parts["content"] = json.dumps(scene).replace("<", r"\u003c")
    page = (_FILES / "viz" / "model.html").read_text(encoding="utf-8")
    return re.sub(r"{{(.*?)}}", lambda match: parts[match[1]], page)


def pose_scene(result: PairResult) -> dict[str, Any]:
    """The scene of a pair for scene.js, as JSON values. Raises InputError without R and t."""
    if result.pose.R is None or result.pose.t is None:
        raise InputError(ArgumentName("result"), f"has no R and t: {result.pose.reason}")
    pose = np.column_stack([result.pose.R, result.pose.t * (result.pose.length or 1.0)])
    first = frustum(result.camera1.K, result.image1.size, np.eye(3, 4))
    second = frustum(result.camera2.K, result.image2.size, pose)
    return scene_of("12", np.stack([first, second]), result.points3d, result.colours, _MOST_OF_PAIR)


def frustum(K: np.ndarray, size: tuple[int, int], pose: np.ndarray) -> np.ndarray:
    """The centre of a camera and the corners of its view at depth 1, clockwise from the top left,
    world (5, 3). K: (3, 3). size: (width, height). pose: cam_from_world (3, 4)."""
    width, height = size
    pixels = np.array([[0, 0], [width, 0], [width, height], [0, height]]) - 0.5
    rays = homogeneous(pixels) @ np.linalg.inv(K).T @ pose[:, :3]
    corners: np.ndarray = np.vstack([np.zeros(3), rays]) - pose[:, :3].T @ pose[:, 3]
    return corners


def mean_axes(poses: Sequence[np.ndarray]) -> np.ndarray:
    """The axes of the mean camera of cam_from_world poses (3, 4), as rows (3, 3): the rotation that
    minimises the sum of |R_k - axes|^2."""
    rows = np.stack(poses)[:, :, :3].transpose(0, 2, 1).reshape(-1, 3)
    return aligning_rotation(np.tile(np.eye(3), (len(poses), 1)), rows)


def scene_of(
    labels: Sequence[str],
    frusta: np.ndarray,
    points: np.ndarray,
    colours: np.ndarray,
    most: int,
    sizes: np.ndarray | float = 1.0,
) -> dict[str, Any]:
    """The scene of cameras with frusta (N, 5, 3), scaled to fit the distances between them, and a
    random sample of at most `most` points (M, 3) with colours (M, 3) uint8. sizes: factors of the
    frusta's sizes, (N,)."""
    centres = frusta[:, :1]
    depth = float(np.median(nearest(centres[:, 0], 2)[0][:, 1])) or 1.0
    away = np.linalg.norm(points - centres.mean(0), axis=1)
    chosen = np.flatnonzero(np.isfinite(away))
    if len(chosen):
        depth = float(np.clip(depth, *np.multiply(_DEPTHS, np.median(away[chosen]))))
        chosen = chosen[away[chosen] <= np.quantile(away[chosen], _NEAR)]
    chosen = np.random.default_rng(0).permutation(chosen)[:most]
    digits = 4 - int(np.floor(np.log10(depth)))
    depths = np.broadcast_to(depth * sizes, len(frusta))
    corners = (centres + depths[:, None, None] * (frusta - centres)).round(digits).tolist()
    cameras = [{"label": label, "corners": c} for label, c in zip(labels, corners, strict=True)]
    xyz = points[chosen].round(digits).tolist()
    rgb = colours[chosen].tolist()
    return {"cameras": cameras, "points": {"xyz": xyz, "rgb": rgb}}
