"""Posed photographs of known depth on a device, and pairs of views cut from them, whose maps follow
from the target's depth and the poses."""

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

_LONGEST = 512  # pixels of a frame's longer side in memory, at most
_PROBE = (16, 20)  # rows and columns of points by which a frame's overlap with others is estimated
_AGREES = 0.05  # of the depth, for such a point
_VISIBLE = 0.03  # of the depth expected in the source: within this of it, the pixel is visible
_HIDDEN = 0.07  # nearer by more, the pixel is occluded; else it is not known
_LEAST_OVERLAP, _LEAST_RIGHT, _LEAST_POINTS = 0.2, 0.3, 12
_MOST_ROLL_DEG = 50.0
_MOST_COUNTED = 2000  # pairs: of more a scene's weight does not rise


@dataclass(frozen=True)
class PosedScenes:
    """The frames of all scenes. A scene's unit of length is about its depth."""

    names: tuple[str, ...]  # of the scenes
    scene: Tensor  # (N,) int64, of each frame
    bank: ImageBank  # of the frames, without lens distortion
    cameras: Cameras  # of the bank's images
    depth: Tensor  # (T,) float32, row by row, along the optical axis, 0: unknown
    start: Tensor  # (N,) int64, a frame's first depth
    size: Tensor  # (N, 2) int64, width and height of its depths, which cover the image

    def depth_at(self, frame: Tensor, points: Tensor) -> Tensor:
        """Depths (B, ...) of frames (B,) at points (B, ..., 2), pixels of the bank's images: those
        of the nearest pixel, 0 outside and if unknown."""
        wide = (len(frame),) + (1,) * (points.ndim - 2)
        size, image = (part[frame].view(*wide, 2) for part in (self.size, self.bank.sizes[:, 0]))
        x, y = ((points + 0.5) * (size / image)).floor().unbind(-1)
        width, height = size.unbind(-1)
        shown = (x >= 0) & (y >= 0) & (x < width) & (y < height)
        index = torch.where(shown, y * width + x, 0).long() + self.start[frame].view(wide)
        return torch.where(shown, self.depth[index], 0.0)


@dataclass(frozen=True)
class FramePairs:
    """Pairs of frames that share enough, of one or more scenes."""

    scenes: PosedScenes
    frames: Tensor  # (P, 2) int64, source and target
    middles: Tensor  # (P, 2, 2), of what both show, pixels of the source and of the target
    chance: Tensor  # (P,) float64, summed up, that a pair is drawn with

    @property
    def names(self) -> list[str]:
        """Of the scenes that have pairs."""
        numbers = self.scenes.scene[self.frames.unique()].unique()
        return [self.scenes.names[number] for number in numbers.tolist()]


def load_posed(
    scenes: Mapping[str, Sequence[PosedFrame]], device: torch.device | str, kept: Path
) -> PosedScenes:
    """Read the frames of scenes; a plane sweep finds the depths of those without a sensor's.

    kept: a folder for the depths that are swept, a file a scene and its frames, poses and reach.
    Raises ImageError if a file cannot be read, InputError for a depth of another shape.
    """
    images, K, poses, depths = list[np.ndarray](), list[Tensor](), list[Tensor](), list[Tensor]()
    for name, frames in tqdm(scenes.items(), desc="scenes", unit="", disable=None, leave=False):
        pixels, pinholes, sensed, reaches = zip(*map(_prepared, frames), strict=True)
        reach, pose = np.array(reaches), np.stack([f.cam_from_world[:3] for f in frames])
        # In single precision: about the cameras, and in units of the depth.
        unit = np.median(np.sqrt(reach.prod(1)))
        middle = -np.einsum("nij,ni->nj", pose[..., :3], pose[..., 3]).mean(0)
        pose[..., 3] = (pose[..., 3] + pose[..., :3] @ middle) / unit
        K.append(torch.from_numpy(np.stack(pinholes)).float().to(device))
        poses.append(torch.from_numpy(pose).float().to(device))
        images += pixels
        if frames[0].depth is not None:
            depths += [torch.from_numpy(depth / np.float32(unit)).to(device) for depth in sensed]
            continue
        digest = hashlib.sha256(repr(frames).encode()).hexdigest()[:16]  # other poses, other depths
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
    """Pixels, fx fy cx cy, depths (h, w), 0 if unknown, and reach of a frame without its lens
    distortion, `_LONGEST` pixels at most."""
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
    K, known = camera.resized(size).K, depth[depth > 0]
    reach = frame.reach or ((known.min(), known.max()) if len(known) else (1.0, 1.0))
    return pixels, np.array([K[0, 0], K[1, 1], K[0, 2], K[1, 2]]), depth, reach


def frame_pairs(scenes: PosedScenes, names: Collection[str]) -> FramePairs:
    """The pairs of some scenes: an overlap of 0.2 and more, the more often the more the view
    changes; a scene weighs as the root of the number of its pairs. Raises InputError without any.
    """
    chosen = [k for k, name in enumerate(scenes.names) if name in names]
    parts = [_scene_pairs(scenes, (scenes.scene == k).nonzero()[:, 0]) for k in chosen]
    frames, middles, weights = map(torch.cat, zip(*parts, strict=True))
    if not len(frames):
        listed = ", ".join(names)
        raise InputError(f"posed: in {listed} no two frames share enough of known depth")
    return FramePairs(scenes, frames, middles, weights.double().cumsum(0))


def _scene_pairs(scenes: PosedScenes, frames: Tensor) -> tuple[Tensor, Tensor, Tensor]:
    """Frames, middles and weights of the pairs of one scene's frames (n,)."""
    count, size = len(frames), scenes.bank.size(frames)
    steps = (torch.arange(n, device=size.device) / n + 0.5 / n for n in _PROBE[::-1])
    grid = torch.stack(torch.meshgrid(*steps, indexing="xy"), -1).view(1, -1, 2)
    points = grid * size[:, None] - 0.5
    depth, cameras = scenes.depth_at(frames, points), scenes.cameras[frames]
    known, place = depth > 0, cameras.unproject(points, depth)
    pairs, middles, weights = [], [], []
    for k, frame in enumerate(frames):  # of the source
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
    """Random pairs of views of `shape`, cut from the frames: rolled, scaled down to 0.55 of the
    frame, about what both show.

    A pixel of the target is visible if it projects into the source view and the source's depth
    agrees there. It is not visible if it projects outside, or well behind the source's depth. It is
    not known if the depth of either is missing, or the two contradict each other.
    """
    scenes, place = pairs.scenes, draw.uniform(count).double() * pairs.chance[-1]
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
    camera1, camera2 = scenes.cameras[source], scenes.cameras[target]
    camera1 = camera1.seen_by(camera2)
    camera2 = Cameras(camera2.K, torch.eye(3, 4, device=draw.device).expand(count, 3, 4))
    projected, expected = camera1.project(camera2.unproject(in_frame2, depth))
    back = torch.linalg.inv_ex(linear1).inverse
    truth = torch.einsum("bij,bhwj->bhwi", back, projected - shift1[:, None, None])
    there, measured = scenes.depth_at(source, projected), depth > 0
    on_view = (expected > 1e-3 * depth) & inside(truth, shape)
    compared, ratio = on_view & (there > 0), there / expected
    visible = measured & compared & ((ratio - 1).abs() < _VISIBLE)
    known = measured & (visible | (compared & (ratio < 1 - _HIDDEN)) | ~on_view)
    return MapPairs(image1.movedim(-1, 1), image2.movedim(-1, 1), truth, visible, known)


def _random_cuts(size: Tensor, middle: Tensor, shape: Shape, draw: Draw) -> tuple[Tensor, Tensor]:
    """Views as maps A u + b from their pixels to the frames': A (B, 2, 2), b (B, 2).

    size: (B, 2), width and height of the frames; middle: (B, 2), pixels, about which a view lies.
    """
    count, extent = len(size), size.new_tensor(shape[::-1]) / root_area(shape)
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
