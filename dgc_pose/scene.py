"""Cameras and points as the values of JSON that a page draws, and image 1 as a map warps it."""

from collections.abc import Sequence
from typing import Any

import cv2
import numpy as np

from dgc_pose.errors import ArgumentName, InputError
from dgc_pose.geometry.epipolar import homogeneous
from dgc_pose.geometry.pixels import Size, rescale
from dgc_pose.geometry.rotation import aligning_rotation
from dgc_pose.geometry.sampling import nearest
from dgc_pose.images.image import resize
from dgc_pose.pair_result import PairResult

SHOWN_SIDE = 1600  # longest side of an image that is shown, pixels
_MOST = 3000  # points of a pair: more would slow a page down
_NEAR = 0.97  # of the points' distances that are shown: the farthest would shrink all others
_DEPTHS = 0.1, 0.18  # of a camera's pyramid, over the median distance of the points


def pose_scene(result: PairResult) -> dict[str, Any]:
    """What scene.js shows of a pair, as values of JSON. Raises InputError without R and t."""
    if result.pose.R is None or result.pose.t is None:
        raise InputError(ArgumentName("result"), f"has no R and t: {result.pose.reason}")
    pose = np.column_stack([result.pose.R, result.pose.t * (result.pose.length or 1.0)])
    first = frustum(result.camera1.K, result.image1.size, np.eye(3, 4))
    second = frustum(result.camera2.K, result.image2.size, pose)
    return scene_of("12", np.stack([first, second]), result.points3d, result.colours, _MOST)


def frustum(K: np.ndarray, size: tuple[int, int], pose: np.ndarray) -> np.ndarray:
    """The centre of a camera and, at a depth of 1, the corners of its view from the top left on
    (5, 3), world. K: (3, 3). size: (width, height). pose: cam_from_world (3, 4)."""
    width, height = size
    pixels = np.array([[0, 0], [width, 0], [width, height], [0, height]]) - 0.5
    rays = homogeneous(pixels) @ np.linalg.inv(K).T @ pose[:, :3]
    corners: np.ndarray = np.vstack([np.zeros(3), rays]) - pose[:, :3].T @ pose[:, 3]
    return corners


def mean_axes(poses: Sequence[np.ndarray]) -> np.ndarray:
    """The axes (3, 3) of the mean camera of cam_from_world poses (3, 4), in rows: of least sum of
    |R_k - axes|^2."""
    rows = np.stack(poses)[:, :, :3].transpose(0, 2, 1).reshape(-1, 3)
    return aligning_rotation(np.tile(np.eye(3), (len(poses), 1)), rows)


def scene_of(
    labels: Sequence[str], frusta: np.ndarray, points: np.ndarray, colours: np.ndarray, most: int
) -> dict[str, Any]:
    """Cameras of some frusta (N, 5, 3), as deep as their distances allow, and at most so many of
    the points (M, 3), of colours (M, 3) uint8, in a random order."""
    centres = frusta[:, :1]
    depth = float(np.median(nearest(centres[:, 0], 2)[0][:, 1])) or 1.0
    away = np.linalg.norm(points - centres.mean(0), axis=1)
    chosen = np.flatnonzero(np.isfinite(away))
    if len(chosen):
        depth = float(np.clip(depth, *np.multiply(_DEPTHS, np.median(away[chosen]))))
        chosen = chosen[away[chosen] <= np.quantile(away[chosen], _NEAR)]
    chosen = np.random.default_rng(0).permutation(chosen)[:most]
    digits = 4 - int(np.floor(np.log10(depth)))
    corners = (centres + depth * (frusta - centres)).round(digits).tolist()
    cameras = [{"label": label, "corners": c} for label, c in zip(labels, corners, strict=True)]
    xyz, rgb = points[chosen].round(digits).tolist(), colours[chosen].tolist()
    return {"cameras": cameras, "points": {"xyz": xyz, "rgb": rgb}}


def warp_image(pixels1: np.ndarray, correspondences: np.ndarray, size: Size) -> np.ndarray:
    """Image 1 sampled at the points (H', W', 2) of a map that is resized to (width, height).

    White outside image 1. Returns (height, width, 3) uint8.
    """
    source = shrunk(pixels1)
    whole, small = pixels1.shape[1::-1], source.shape[1::-1]
    points = cv2.resize(correspondences.astype(np.float32), size)
    x, y = np.moveaxis(rescale(points, whole, small).astype(np.float32), -1, 0)
    white = (255, 255, 255)
    return cv2.remap(
        source, x, y, cv2.INTER_LINEAR, borderMode=cv2.BORDER_CONSTANT, borderValue=white
    )


def shown_size(size: Size) -> Size:
    """(width, height) with the longest side at most `SHOWN_SIDE`."""
    scale = min(1.0, SHOWN_SIDE / max(size))
    return max(1, round(size[0] * scale)), max(1, round(size[1] * scale))


def shrunk(pixels: np.ndarray) -> np.ndarray:
    """An image (H, W, 3) at its `shown_size`."""
    return resize(pixels, shown_size((pixels.shape[1], pixels.shape[0])))
