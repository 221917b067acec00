"""Views in torch: pixels, cameras, and batches of pairs with their true maps at the finest and at
coarser levels. Pixel (0, 0) is the centre of the top-left pixel."""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import NamedTuple

import numpy as np
import torch
from torch import Tensor
from torch.nn.functional import cosine_similarity, normalize

from dgc_pose.geometry import pixels

Shape = tuple[int, int]  # rows and columns of a view, pixels
_NEAREST = 1e-6  # least depth to divide by
# A cell whose four central pixels map this far apart (pixels) straddles two surfaces: invalid.
_STRADDLES_PX = 6.0


class MapPairs(NamedTuple):
    """A batch of pairs with their true maps."""

    image1: Tensor  # (B, 3, H, W) source in [0, 1]
    image2: Tensor  # (B, 3, H, W) target in [0, 1]
    map: Tensor  # (B, H, W, 2) x and y of each target pixel in the source, pixels
    valid: Tensor  # (B, H, W) bool, whether the target's pixel is visible in the source
    # (B, H, W) bool, whether `valid` is known; elsewhere neither map nor mask is learnt
    known: Tensor


def image_arrays(images: Tensor) -> np.ndarray:
    """Convert images (B, 3, H, W) in [0, 1] to (B, H, W, 3) uint8."""
    return (255 * images.permute(0, 2, 3, 1)).round().byte().contiguous().cpu().numpy()


def level_truth(truth: Tensor, valid: Tensor, rows: int) -> tuple[Tensor, Tensor]:
    """The true map at a level with `rows` rows: points at the cells' centres, (B, rows, columns, 2)
    pixels, and the mask of valid cells.

    truth: (B, H, W, 2) pixels; valid: (B, H, W). The centre of a cell of s > 1 pixels lies between
    its four central pixels. Their mean is its truth, valid if all four are and lie on one surface.
    """
    stride = truth.shape[1] // rows
    if stride == 1:
        return truth, valid
    central = _central_pixels(truth, stride)
    spread = (central.amax(0) - central.amin(0)).amax(-1)
    whole = level_known(valid, rows)
    return central.mean(0), whole & (spread < max(_STRADDLES_PX, 2.0 * stride / 4))


def level_known(known: Tensor, rows: int) -> Tensor:
    """Whether all central pixels of each cell (B, rows, columns) are `known` (B, H, W)."""
    stride = known.shape[1] // rows
    return known if stride == 1 else _central_pixels(known, stride).all(0)


def _central_pixels(values: Tensor, stride: int) -> Tensor:
    """The four pixels around each cell's centre: (B, H, W, ...) to (4, B, h, w, ...)."""
    two = (stride // 2 - 1, stride // 2)
    return torch.stack([values[:, y::stride, x::stride] for y in two for x in two])


@dataclass(frozen=True)
class Cameras:
    """B pinhole cameras. OpenCV axes."""

    K: Tensor  # (B, 4), fx fy cx cy, pixels
    pose: Tensor  # (B, 3, 4), camera from world

    @classmethod
    def looking(cls, K: Tensor, centre: Tensor, target: Tensor, roll: Tensor) -> Cameras:
        """Cameras at `centre` (B, 3) that look at `target` (B, 3), with y down like the world's,
        rotated about the optical axis by `roll` (B,) radians."""
        z = normalize(target - centre, dim=-1)
        down = z.new_tensor((0.0, 1.0, 0.0)).expand_as(z)
        x = normalize(torch.linalg.cross(down, z), dim=-1)
        upright = torch.stack([x, torch.linalg.cross(z, x), z], -2)
        return cls.at(K, about_axis(roll, 2) @ upright, centre)

    @classmethod
    def at(cls, K: Tensor, rotation: Tensor, centre: Tensor) -> Cameras:
        """Cameras with rotations (B, 3, 3), camera from world, and centres (B, 3)."""
        return cls(K, torch.cat([rotation, -rotation @ centre[..., None]], -1))

    @property
    def centre(self) -> Tensor:
        """(B, 3), world."""
        return -(self.pose[..., :3].mT @ self.pose[..., 3:])[..., 0]

    def __getitem__(self, which: Tensor | slice | list[int]) -> Cameras:
        return Cameras(self.K[which], self.pose[which])

    def seen_by(self, other: Cameras) -> Cameras:
        """The same cameras, with `other`'s camera coordinates as the world."""
        turn = self.pose[..., :3] @ other.pose[..., :3].mT
        shift = self.pose[..., 3:] - turn @ other.pose[..., 3:]
        return Cameras(self.K, torch.cat([turn, shift], -1))

    def rays(self, points: Tensor) -> Tensor:
        """Directions (B, ..., 3) of points (B, ..., 2), pixels, in camera axes, with z = 1."""
        focal, middle = _wide(self.K, points).split(2, -1)
        return torch.cat([(points - middle) / focal, torch.ones_like(points[..., :1])], -1)

    def project(self, points: Tensor) -> tuple[Tensor, Tensor]:
        """Pixels (B, ..., 2), bounded, and depths (B, ...) of world points (B, ..., 3)."""
        turn = self.pose[..., :3]
        shift = _wide(self.pose[..., 3], points)
        moved = torch.einsum("bij,b...j->b...i", turn, points) + shift
        focal, middle = _wide(self.K, points).split(2, -1)
        depth = moved[..., 2]
        flat = moved[..., :2] / depth.clamp(min=_NEAREST)[..., None]
        return (flat * focal + middle).clamp(-1e5, 1e5), depth

    def unproject(self, points: Tensor, depth: Tensor) -> Tensor:
        """World points (B, ..., 3) of pixels (B, ..., 2) at depths (B, ...)."""
        inside = self.rays(points) * depth[..., None] - _wide(self.pose[..., 3], points)
        return torch.einsum("bji,b...j->b...i", self.pose[..., :3], inside)


def _wide(values: Tensor, like: Tensor) -> Tensor:
    """Reshape (B, n) to the number of dimensions of `like` (B, ..., m)."""
    return values.view(len(values), *(1,) * (like.ndim - 2), values.shape[-1])


def about_axis(angle: Tensor, axis: int) -> Tensor:
    """Rotations (..., 3, 3) by angles (...), radians, about x, y or z (axis 0, 1 or 2)."""
    i = (axis + 1) % 3
    j = (axis + 2) % 3
    turn = torch.eye(3, device=angle.device).repeat(*angle.shape, 1, 1)
    turn[..., i, i] = turn[..., j, j] = angle.cos()
    turn[..., j, i] = angle.sin()
    turn[..., i, j] = -turn[..., j, i]
    return turn


def rotation_2d(angle: Tensor) -> Tensor:
    """Rotations (B, 2, 2) by angles (B,), radians."""
    return about_axis(angle, 2)[:, :2, :2]


def angle_deg(rays1: Tensor, rays2: Tensor) -> Tensor:
    """Angles (...), degrees, between rays (..., 3)."""
    cosine = cosine_similarity(rays1, rays2, dim=-1)
    return torch.rad2deg(torch.acos(cosine.clamp(-1, 1)))


def pixel_grid(shape: tuple[int, ...], device: torch.device) -> Tensor:
    """The pixels' centres (H, W, 2)."""
    return torch.from_numpy(pixels.pixel_grid((shape[1], shape[0]))).float().to(device)


def middle_of(shape: Shape, device: torch.device) -> Tensor:
    """The middle (2,) of a view, pixels."""
    return torch.tensor([(shape[1] - 1) / 2, (shape[0] - 1) / 2], device=device)


def root_area(shape: Shape) -> float:
    """The side of a square with as many pixels as the view."""
    return math.sqrt(shape[0] * shape[1])


def inside(points: Tensor, size: Tensor | tuple[int, ...]) -> Tensor:
    """Whether points (..., 2), pixels, lie in an image, between -0.5 and its size - 0.5.

    size: (..., 2), width and height, or the shape of a view.
    """
    if isinstance(size, tuple):
        size = points.new_tensor(size[::-1])
    return ((points > -0.5) & (points < size - 0.5)).all(-1)
