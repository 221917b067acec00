"""Real scenes of known depth in memory: frames as squares, and which of them make pairs."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np
import torch
import torch.nn.functional as F
from torch import Tensor
from tqdm import tqdm

from dgc_pose.cameras.camera import Camera
from dgc_pose.errors import InputError
from dgc_pose.images.image import load_image
from dgc_pose.training.synthesis.map_pairs import changed, joined, point_grid
from dgc_pose.training.synthesis.photos import SIDE, resized_planes
from dgc_pose.training.synthesis.posed_depth import PosedFrame

# Four neighbouring depths further apart than this (of the nearest) lie on several surfaces.
_STRADDLES = 0.05
_AGREES = 0.03  # tolerance of the depth in the count of overlap, relative
_PROBE = 16  # overlap is counted on so many pixels squared


@dataclass(frozen=True)
class FramePairOptions:
    """The ranges of two frames of a scene that make a pair."""

    # Share of the target's pixels of known depth that are visible in the source.
    overlap: tuple[float, float] = (0.3, 0.98)
    baseline: tuple[float, float] = (0.03, 1.5)  # between the cameras, of the target's median depth
    rotation_deg: float = 60.0  # at most
    # Pairs for each frame of a scene, at most; drawn in proportion to the change of view, as most
    # pairs of a walk are near. None: all.
    per_frame: int | None = None


FRAME_PAIRS = {
    "near": FramePairOptions(),
    "far": FramePairOptions((0.15, 0.97), (0.03, 2.5), rotation_deg=90.0, per_frame=40),
}


@dataclass(frozen=True)
class DepthScenes:
    """The frames of all scenes, and pairs of them. A scene's unit of length is its median depth."""

    images: Tensor  # (N, 3, side, side) uint8, RGB
    depth: Tensor  # (N, side, side) float16, along the optical axis, 0: unknown
    K: Tensor  # (N, 3, 3) float32, pixels of the squares
    pairs: Tensor  # (P, 2) int64, source and target
    source_from_target: Tensor  # (P, 3, 4) float32, X1 = R X2 + t

    def to(self, device: torch.device | str) -> DepthScenes:
        """The scenes on another device; `pairs` stays on the CPU, which draws from it."""
        return replace(changed(self, lambda values: values.to(device)), pairs=self.pairs)


def training_frames(frames: Sequence[PosedFrame]) -> Sequence[PosedFrame]:
    """The frames of a walk without its last tenth, which is held back."""
    return frames[: len(frames) - round(0.1 * len(frames))]


def load_depth_scenes(
    scenes: Sequence[Sequence[PosedFrame]],
    choice: FramePairOptions = FramePairOptions(),
    side: int = SIDE,
) -> DepthScenes:
    """Read the frames of scenes and choose their pairs.

    Raises ImageError if a file cannot be read, InputError if no two frames make a pair.
    """
    total = sum(map(len, scenes))
    parts, first = [], 0
    with tqdm(total=total, desc="frames", unit="", disable=None, leave=False) as bar:
        for frames in filter(None, scenes):
            part = _load_scene(frames, choice, side, bar)
            parts.append(replace(part, pairs=part.pairs + first))
            first += len(frames)
    if not any(len(part.pairs) for part in parts):
        raise InputError(f"of {total} frames no two overlap as they should to make a pair")
    return joined(parts)


def _load_scene(
    frames: Sequence[PosedFrame], choice: FramePairOptions, side: int, bar: tqdm
) -> DepthScenes:
    squares = []
    for frame in frames:
        squares.append(_square(frame, side))
        bar.update()
    images, depth, K = map(torch.stack, zip(*squares, strict=True))
    cam_from_world = torch.tensor(np.stack([frame.cam_from_world for frame in frames]))
    sparse = depth[:, ::4, ::4]
    unit = float(sparse[sparse > 0].median()) if (sparse > 0).any() else 1.0
    depth = depth / unit
    cam_from_world[:, :3, 3] /= unit
    pairs, poses = _choose(depth, K, cam_from_world, choice)
    if choice.per_frame is not None and len(pairs) > choice.per_frame * len(frames):
        # A baseline of one median depth counts as 40 degrees of rotation.
        baseline = poses[:, :, 3].norm(dim=1).clamp(max=1.5)
        change = ((_rotation_deg(poses) + 40 * baseline) / 30).clamp(0.15, 2.0)
        generator = torch.Generator().manual_seed(len(poses))
        count = choice.per_frame * len(frames)
        drawn = torch.multinomial(change, count, generator=generator).sort().values
        pairs, poses = pairs[drawn], poses[drawn]
    return DepthScenes(images, depth.half(), K.float(), pairs, poses.float())


def _rotation_deg(poses: Tensor) -> Tensor:
    """Angles (P,) of poses (P, 3 or 4, 4)."""
    cosine = (poses[:, :3, :3].diagonal(dim1=1, dim2=2).sum(1) - 1) / 2
    return torch.rad2deg(torch.acos(cosine.clamp(-1, 1)))


def depth_at(depth: Tensor, frame: Tensor, points: Tensor) -> tuple[Tensor, Tensor]:
    """Depth (B, n) at points (B, n, 2), pixels, of frames (B,) of (N, h, w), and a mask of the
    points of known depth.

    Linear in the inverse depth, which is exact on planes. The depth is not known, and 1, outside
    the frame, if one of the four neighbours is not known, or if they lie on several surfaces.
    """
    height, width = depth.shape[1:]
    x, y = points.unbind(-1)
    inside = (x >= 0) & (x <= width - 1) & (y >= 0) & (y <= height - 1)
    x, y = x.clamp(0, width - 1), y.clamp(0, height - 1)
    left, top = x.floor().clamp(max=width - 2), y.floor().clamp(max=height - 2)
    u, v = x - left, y - top
    first = frame[:, None] * (height * width) + top.long() * width + left.long()
    steps = (0, 1, width, width + 1)
    flat = depth.reshape(-1)
    corners = torch.stack([flat[first + step] for step in steps]).to(points.dtype)
    weights = torch.stack([(1 - u) * (1 - v), u * (1 - v), (1 - u) * v, u * v])
    nearest = corners.amin(0)
    known = inside & (nearest > 0) & (corners.amax(0) < (1 + _STRADDLES) * nearest)
    inverse = (weights / corners).sum(0)
    return torch.where(known, 1 / inverse, 1.0), known


def _square(frame: PosedFrame, side: int) -> tuple[Tensor, Tensor, Tensor]:
    """Image (3, side, side) uint8, depth (side, side) float32 and K (3, 3) float64 of a square."""
    pixels = load_image(frame.image).pixels
    K = Camera(frame.K, (pixels.shape[1], pixels.shape[0])).resized((side, side)).K
    pixel = torch.arange(side, dtype=torch.float64)
    x, y = (
        (pixel - K[axis, 2]) / K[axis, axis] * frame.K[axis, axis] + frame.K[axis, 2]
        for axis in (0, 1)
    )
    stored = torch.from_numpy(frame.read_depth())
    if min(stored.shape) < 2:
        raise InputError(f"{frame.depth}: a depth image must have 2 pixels a side at least")
    first = torch.zeros(1, dtype=torch.int64)
    depth, known = depth_at(stored[None], first, point_grid(x, y))
    squared = torch.where(known, depth, 0.0).view(side, side).float()
    return resized_planes(pixels, (side, side)), squared, torch.tensor(K)


def _choose(
    depth: Tensor, K: Tensor, cam_from_world: Tensor, choice: FramePairOptions
) -> tuple[Tensor, Tensor]:
    """Pairs (P, 2) of the frames of one scene, source and target, and their poses (P, 3, 4)."""
    count, side = len(depth), depth.shape[-1]
    pixel = (torch.arange(_PROBE, dtype=torch.float64) + 0.5) * side / _PROBE - 0.5
    points = point_grid(pixel)
    rays = F.pad(points, (0, 1), value=1.0)
    frames = torch.arange(count)
    pairs, poses = [], []
    for target in range(count):
        z, known = depth_at(depth, frames[target : target + 1], points)
        total = int(known.sum())
        if total == 0:
            continue
        relative = cam_from_world @ torch.linalg.inv(cam_from_world[target])
        seen = rays @ torch.linalg.inv(K[target]).T * z[..., None]
        moved = seen[known] @ relative[:, :3, :3].mT + relative[:, None, :3, 3]
        in_front = moved[..., 2] > 1e-6
        flat = moved @ K.mT
        projected = flat[..., :2] / flat[..., 2:].clamp(min=1e-6)
        there, sees = depth_at(depth, frames, projected)
        sees &= in_front & ((there / moved[..., 2].clamp(min=1e-6) - 1).abs() < _AGREES)
        overlap = sees.sum(1) / total
        baseline = relative[:, :3, 3].norm(dim=1) / z[known].median()
        rotation = _rotation_deg(relative)
        fits = (overlap >= choice.overlap[0]) & (overlap <= choice.overlap[1])
        fits &= (baseline >= choice.baseline[0]) & (baseline <= choice.baseline[1])
        fits &= rotation <= choice.rotation_deg
        fits[target] = False
        sources = frames[fits]
        pairs.append(torch.stack([sources, torch.full_like(sources, target)], 1))
        poses.append(relative[fits, :3])
    if not pairs:
        return torch.empty(0, 2, dtype=torch.int64), torch.empty(0, 3, 4, dtype=torch.float64)
    return torch.cat(pairs), torch.cat(poses)
