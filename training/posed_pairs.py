"""Posed photographs with depths on a device, and pairs of views cut from them. The target's depth
and the poses give the true maps."""

from __future__ import annotations

import hashlib
import math
from collections.abc import Collection, Mapping, Sequence
from dataclasses import dataclass, replace
from pathlib import Path

import cv2
import numpy as np
import torch
from torch import Tensor
from tqdm import tqdm

from dgc_pose.errors import InputError
from dgc_pose.geometry.pixels import pixel_grid as centres
from dgc_pose.images.image import load_image, resize_by
from dgc_pose.network.weights import load_checkpoint
from dgc_pose.system.files import replaced
from dgc_pose.training.draw import Draw
from dgc_pose.training.photos import ImageBank
from dgc_pose.training.plane_sweep import swept_depths
from dgc_pose.training.posed_frames import PosedFrame
from dgc_pose.training.views import (
    Cameras,
    MapPairs,
    Shape,
    angle_deg,
    inside,
    middle_of,
    pixel_grid,
    root_area,
    rotation_2d,
)

_LONGEST = 512  # pixels, largest length of a frame's longer side in memory
_PROBE = (16, 20)  # rows and columns of points for estimating the overlap of frames
_AGREES = 0.05  # largest relative difference of depths that agree at such a point
_VISIBLE = 0.03  # a pixel is visible if the source's depth is this close to the expected, relative
_HIDDEN = 0.07  # a pixel is hidden if the source's depth is nearer by more than this; else unknown
_LEAST_OVERLAP = 0.2
_LEAST_RIGHT = 0.3
_LEAST_POINTS = 12
_MOST_ROLL_DEG = 50.0
_MOST_COUNTED = 2000  # pairs; more do not increase a scene's weight


@dataclass(frozen=True)
class PosedScenes:
    """The frames of all scenes. A scene's unit of length is about its depth."""

    names: tuple[str, ...]  # of the scenes
    scene: Tensor  # (N,) int64, scene of each frame
    bank: ImageBank  # frames without lens distortion
    cameras: Cameras  # of the bank's images
    depth: Tensor  # (T,) float32, along the optical axis, row by row; 0: unknown
    start: Tensor  # (N,) int64, index of each frame's first depth
    size: Tensor  # (N, 2) int64, width and height of each depth map, which covers the image

    def depth_at(self, frame: Tensor, points: Tensor) -> Tensor:
        """Depths (B, ...) of frames (B,) at points (B, ..., 2), pixels of the bank's images, from
        the nearest pixel of the depth map; 0 if outside or unknown."""
        wide = (len(frame),) + (1,) * (points.ndim - 2)
        size, image = (part[frame].view(*wide, 2) for part in (self.size, self.bank.sizes[:, 0]))
        x, y = ((points + 0.5) * (size / image)).floor().unbind(-1)
        width, height = size.unbind(-1)
        shown = (x >= 0) & (y >= 0) & (x < width) & (y < height)
        index = torch.where(shown, y * width + x, 0).long() + self.start[frame].view(wide)
        return torch.where(shown, self.depth[index], 0.0)


@dataclass(frozen=True)
class FramePairs:
    """Pairs of frames with enough overlap, from one or more scenes."""

    scenes: PosedScenes
    frames: Tensor  # (P, 2) int64, source and target
    middles: Tensor  # (P, 2, 2), middles of the common part, pixels of the source and the target
    chance: Tensor  # (P,) float64, cumulative sum of the weights with which pairs are drawn

    @property
    def names(self) -> list[str]:
        """The names of the scenes with pairs."""
        numbers = self.scenes.scene[self.frames.unique()].unique()
        return [self.scenes.names[number] for number in numbers.tolist()]


def load_posed(
    scenes: Mapping[str, Sequence[PosedFrame]], device: torch.device | str, kept: Path
) -> PosedScenes:
    """Read the frames of scenes; a plane sweep finds their depths if there is no sensor.

    kept: a folder for swept depths, with a file per scene, named by a hash of its frames. Raises
    ImageError if a file is unreadable, InputError if the shape of a depth differs from its image.
    """
    images = list[np.ndarray]()
    K = list[Tensor]()
    poses = list[Tensor]()
    depths = list[Tensor]()
    for name, frames in tqdm(scenes.items(), desc="scenes", unit="", disable=None, leave=False):
        pixels, pinholes, sensed, reaches = zip(*map(_prepared, frames), strict=True)
        reach = np.array(reaches)
        pose = np.stack([f.cam_from_world[:3] for f in frames])
        # Origin among the cameras, and units of the depth: for single precision.
        unit = np.median(np.sqrt(reach.prod(1)))
        middle = -np.einsum("nij,ni->nj", pose[..., :3], pose[..., 3]).mean(0)
        pose[..., 3] = (pose[..., 3] + pose[..., :3] @ middle) / unit
        K.append(torch.from_numpy(np.stack(pinholes)).float().to(device))
        poses.append(torch.from_numpy(pose).float().to(device))
        images += pixels
        if frames[0].depth is not None:
            depths += [torch.from_numpy(depth / np.float32(unit)).to(device) for depth in sensed]
            continue
        digest = hashlib.sha256(repr(frames).encode()).hexdigest()[:16]  # new poses need new depths
        path = kept / f"{name}-{digest}.pt"
        if not path.exists():
            bounds = torch.from_numpy(reach / unit).float().to(device)
            swept = swept_depths(ImageBank.of(pixels, device), Cameras(K[-1], poses[-1]), bounds)
            kept.mkdir(parents=True, exist_ok=True)
            with replaced(path) as temporary:
                torch.save(swept, temporary)
        depths += load_checkpoint(path, device)
    counts = torch.tensor([depth.numel() for depth in depths], device=device)
    return PosedScenes(
        tuple(scenes),
        torch.tensor([k for k, views in enumerate(K) for _ in views], device=device),
        ImageBank.of(images, device),
        Cameras(torch.cat(K), torch.cat(poses)),
        torch.cat([depth.flatten() for depth in depths]),
        counts.cumsum(0) - counts,
        torch.tensor([depth.shape[::-1] for depth in depths], device=device),
    )


def _prepared(
    frame: PosedFrame,
) -> tuple[np.ndarray, np.ndarray, np.ndarray, tuple[float, float]]:
    """Undistort a frame and resize it to at most `_LONGEST` pixels: its pixels, fx fy cx cy, depths
    (h, w), 0 if unknown, and reach."""
    pixels = load_image(frame.image).pixels
    height, width = pixels.shape[:2]
    camera = replace(frame.camera, size=(width, height))
    depth = np.zeros((1, 1), np.float32) if frame.depth is None else frame.read_depth()
    if camera.distortion is not None:
        ideal = replace(camera, distortion=None).normalise(centres((width, height)).reshape(-1, 2))
        x, y = cv2.split(camera.project(ideal).reshape(height, width, 2).astype(np.float32))
        pixels = cv2.remap(pixels, x, y, cv2.INTER_LINEAR)
        if frame.depth is not None:
            depth = cv2.remap(depth, x, y, cv2.INTER_NEAREST)
    pixels = resize_by(pixels, min(1.0, _LONGEST / max(width, height)))
    size = pixels.shape[1], pixels.shape[0]
    if depth.shape[1] > size[0]:
        depth = cv2.resize(depth, size, interpolation=cv2.INTER_NEAREST_EXACT)
    K = camera.resized(size).K
    known = depth[depth > 0]
    reach = frame.reach or ((known.min(), known.max()) if len(known) else (1.0, 1.0))
    return pixels, np.array([K[0, 0], K[1, 1], K[0, 2], K[1, 2]]), depth, reach


def frame_pairs(scenes: PosedScenes, names: Collection[str]) -> FramePairs:
    """The pairs of frames of some scenes with an overlap above 0.2. A pair's weight grows with the
    change of view, a scene's with the root of its number of pairs. Raises InputError without pairs.
    """
    chosen = [k for k, name in enumerate(scenes.names) if name in names]
    parts = [_scene_pairs(scenes, (scenes.scene == k).nonzero()[:, 0]) for k in chosen]
    frames, middles, weights = map(torch.cat, zip(*parts, strict=True))
    if not len(frames):
        listed = ", ".join(names)
        raise InputError(f"posed: no two frames of {listed} share enough pixels of known depth")
    return FramePairs(scenes, frames, middles, weights.double().cumsum(0))


def _scene_pairs(scenes: PosedScenes, frames: Tensor) -> tuple[Tensor, Tensor, Tensor]:
    """Frames, middles and weights of the pairs of one scene's frames (n,)."""
    count = len(frames)
    size = scenes.bank.size(frames)
    steps = (torch.arange(n, device=size.device) / n + 0.5 / n for n in _PROBE[::-1])
    grid = torch.stack(torch.meshgrid(*steps, indexing="xy"), -1).view(1, -1, 2)
    points = grid * size[:, None] - 0.5
    depth = scenes.depth_at(frames, points)
    cameras = scenes.cameras[frames]
    known = depth > 0
    place = cameras.unproject(points, depth)
    pairs = []
    middles = []
    weights = []
    for k, frame in enumerate(frames):  # the source
        seen, away = cameras[[k] * count].project(place)
        there = scenes.depth_at(frame.expand(count), seen)
        ahead = known & (away > 0)
        compared = ahead & (there > 0)
        agree = compared & ((there / away - 1).abs() < _AGREES)
        agreeing = agree.sum(1)
        right = agreeing / compared.sum(1).clamp(min=1)
        shown = (ahead & inside(seen, size[k])).sum(1) / known.sum(1).clamp(min=1)
        angle = angle_deg(place - cameras.centre[:, None], place - cameras.centre[k])
        parallax = (angle * agree).sum(1) / agreeing.clamp(min=1)
        R = cameras.pose[k, :, :3] @ cameras.pose[..., :3].mT
        cosine = (R.diagonal(dim1=1, dim2=2).sum(1) - 1) / 2
        turn = torch.rad2deg(torch.acos(cosine.clamp(-1, 1)))
        roll = torch.rad2deg(torch.atan2(R[:, 1, 0] - R[:, 0, 1], R[:, 0, 0] + R[:, 1, 1])).abs()
        good = (shown * right > _LEAST_OVERLAP) & (right > _LEAST_RIGHT) & (roll < _MOST_ROLL_DEG)
        good &= (agreeing >= _LEAST_POINTS) & (frames != frame)
        change = parallax.maximum(0.5 * turn)
        share = agree.float() / agreeing[:, None].clamp(min=1)
        both = torch.stack([(part * share[..., None]).sum(1) for part in (seen, points)], 1)
        pairs.append(torch.stack([frame.expand(count), frames], 1)[good])
        middles.append(both[good])
        weights.append((0.15 + change / 25).clamp(max=2.5)[good])
    weight = torch.cat(weights)
    weight = weight / weight.sum() * math.sqrt(min(len(weight), _MOST_COUNTED))
    return torch.cat(pairs), torch.cat(middles), weight


def posed_pairs(pairs: FramePairs, count: int, shape: Shape, draw: Draw) -> MapPairs:
    """Random pairs of views of `shape`, cut from the frames around their common part, rolled and
    scaled down to 0.55 of the frame.

    A pixel of the target is visible if it projects into the source view and the source's depth
    agrees there. It is hidden if it projects outside, or well behind the source's depth. It is
    unknown if either depth is missing or the two contradict each other.
    """
    scenes = pairs.scenes
    place = draw.uniform(count).double() * pairs.chance[-1]
    chosen = torch.searchsorted(pairs.chance, place).clamp(max=len(pairs.frames) - 1)
    source, target = pairs.frames[chosen].unbind(1)
    middle1, middle2 = pairs.middles[chosen].unbind(1)
    linear1, shift1 = _random_cuts(scenes.bank.size(source), middle1, shape, draw)
    linear2, shift2 = _random_cuts(scenes.bank.size(target), middle2, shape, draw)
    pixels = pixel_grid(shape, draw.device).expand(count, -1, -1, -1)
    in_frame1, in_frame2 = (
        torch.einsum("bij,bhwj->bhwi", linear, pixels) + shift[:, None, None]
        for linear, shift in ((linear1, shift1), (linear2, shift2))
    )
    image1 = scenes.bank.view(source, in_frame1)
    image2 = scenes.bank.view(target, in_frame2)
    depth = scenes.depth_at(target, in_frame2)
    camera1 = scenes.cameras[source]
    camera2 = scenes.cameras[target]
    camera1 = camera1.seen_by(camera2)
    camera2 = Cameras(camera2.K, torch.eye(3, 4, device=draw.device).expand(count, 3, 4))
    projected, expected = camera1.project(camera2.unproject(in_frame2, depth))
    back = torch.linalg.inv_ex(linear1).inverse
    truth = torch.einsum("bij,bhwj->bhwi", back, projected - shift1[:, None, None])
    there = scenes.depth_at(source, projected)
    measured = depth > 0
    on_view = (expected > 1e-3 * depth) & inside(truth, shape)
    compared = on_view & (there > 0)
    ratio = there / expected
    visible = measured & compared & ((ratio - 1).abs() < _VISIBLE)
    known = measured & (visible | (compared & (ratio < 1 - _HIDDEN)) | ~on_view)
    return MapPairs(image1.movedim(-1, 1), image2.movedim(-1, 1), truth, visible, known)


def _random_cuts(size: Tensor, middle: Tensor, shape: Shape, draw: Draw) -> tuple[Tensor, Tensor]:
    """Random views as maps A u + b from their pixels to the frames' pixels: A (B, 2, 2), b (B, 2).

    size: (B, 2), width and height of the frames; middle: (B, 2), pixels; views lie around it.
    """
    count = len(size)
    extent = size.new_tensor(shape[::-1]) / root_area(shape)
    side = (size / extent).amin(1) * draw.log_uniform(count, low=0.55, high=1.0)
    aspect = draw.log_uniform(count, low=0.78, high=1.28)
    stretch = torch.stack([aspect.clamp(max=1), (1 / aspect).clamp(max=1)], -1)
    roll = rotation_2d(math.radians(7) * draw.normal(count))
    linear = roll @ torch.diag_embed(stretch * side[:, None] / root_area(shape))
    reach = (linear.abs() * size.new_tensor(shape[::-1])).sum(-1) / 2
    free = (size / 2 - reach).clamp(min=0)
    wanted = middle + 0.17 * side[:, None] * draw.normal(count, 2) - (size - 1) / 2
    centre = (size - 1) / 2 + wanted.minimum(free).maximum(-free)
    return linear, centre - linear @ middle_of(shape, draw.device)
