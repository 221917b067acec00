"""Cameras of views in torch, and the pixels of views. Pixel (0, 0) is the top-left one's centre."""

from __future__ import annotations

import math
from dataclasses import dataclass

import torch
from torch import Tensor

Shape = tuple[int, int]  # rows and columns of a view, pixels
NEAREST = 1e-6  # depths below are not divided by


@dataclass(frozen=True)
class Cameras:
    """B pinhole cameras. OpenCV axes."""

    K: Tensor  # (B, 4), fx fy cx cy, pixels
    pose: Tensor  # (B, 3, 4), camera from world

    @classmethod
    def looking(cls, K: Tensor, centre: Tensor, target: Tensor, roll: Tensor) -> Cameras:
        """Cameras at `centre` (B, 3) that look at `target` (B, 3), y down as the world's, turned
        about the optical axis by `roll` (B,) radians."""
        z = torch.nn.functional.normalize(target - centre, dim=-1)
        down = z.new_tensor((0.0, 1.0, 0.0)).expand_as(z)
        x = torch.nn.functional.normalize(torch.linalg.cross(down, z), dim=-1)
        upright = torch.stack([x, torch.linalg.cross(z, x), z], -2)
        return cls.at(K, about_axis(roll, 2) @ upright, centre)

    @classmethod
    def at(cls, K: Tensor, rotation: Tensor, centre: Tensor) -> Cameras:
        """Cameras of rotations (B, 3, 3), camera from world, whose centres (B, 3) are given."""
        return cls(K, torch.cat([rotation, -rotation @ centre[..., None]], -1))

    @property
    def centre(self) -> Tensor:
        """(B, 3), world."""
        return -(self.pose[..., :3].mT @ self.pose[..., 3:])[..., 0]

    def __getitem__(self, which: Tensor | slice | list[int]) -> Cameras:
        return Cameras(self.K[which], self.pose[which])

    def seen_by(self, other: Cameras) -> Cameras:
        """The same cameras in a world whose axes are those of `other`."""
        turn = self.pose[..., :3] @ other.pose[..., :3].mT
        shift = self.pose[..., 3:] - turn @ other.pose[..., 3:]
        return Cameras(self.K, torch.cat([turn, shift], -1))

    def rays(self, points: Tensor) -> Tensor:
        """Directions (B, ..., 3) in the camera, z = 1, of points (B, ..., 2), pixels."""
        focal, middle = _wide(self.K, points).split(2, -1)
        return torch.cat([(points - middle) / focal, torch.ones_like(points[..., :1])], -1)

    def project(self, points: Tensor) -> tuple[Tensor, Tensor]:
        """Pixels (B, ..., 2), bounded, and depths (B, ...) of points (B, ..., 3), world."""
        turn, shift = self.pose[..., :3], _wide(self.pose[..., 3], points)
        moved = torch.einsum("bij,b...j->b...i", turn, points) + shift
        focal, middle = _wide(self.K, points).split(2, -1)
        depth = moved[..., 2]
        flat = moved[..., :2] / depth.clamp(min=NEAREST)[..., None]
        return (flat * focal + middle).clamp(-1e5, 1e5), depth

    def unproject(self, points: Tensor, depth: Tensor) -> Tensor:
        """World points (B, ..., 3) of pixels (B, ..., 2) at depths (B, ...)."""
        inside = self.rays(points) * depth[..., None] - _wide(self.pose[..., 3], points)
        return torch.einsum("bji,b...j->b...i", self.pose[..., :3], inside)


def _wide(values: Tensor, like: Tensor) -> Tensor:
    """(B, n) with as many dimensions as `like` (B, ..., m)."""
    return values.view(len(values), *(1,) * (like.ndim - 2), values.shape[-1])


def about_axis(angle: Tensor, axis: int) -> Tensor:
    """Rotations (..., 3, 3) by angles (...), radians, about x, y or z (axis 0, 1 or 2)."""
    i, j = (axis + 1) % 3, (axis + 2) % 3
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
    cosine = torch.nn.functional.cosine_similarity(rays1, rays2, dim=-1)
    return torch.rad2deg(torch.acos(cosine.clamp(-1, 1)))


def pixel_grid(shape: tuple[int, ...], device: torch.device) -> Tensor:
    """The pixels' centres (H, W, 2)."""
    y, x = (torch.arange(side, dtype=torch.float32, device=device) for side in shape)
    return torch.stack(torch.meshgrid(x, y, indexing="xy"), -1)


def middle_of(shape: Shape, device: torch.device) -> Tensor:
    """The middle (2,) of a view, pixels."""
    return torch.tensor([(shape[1] - 1) / 2, (shape[0] - 1) / 2], device=device)


def root_area(shape: Shape) -> float:
    """The side of the square with as many pixels."""
    return math.sqrt(shape[0] * shape[1])


def inside(points: Tensor, size: Tensor | tuple[int, ...]) -> Tensor:
    """Which points (..., 2), pixels, lie in an image, its outer edges included.

    size: (..., 2), width and height, or the shape of a view.
    """
    if isinstance(size, tuple):
        size = points.new_tensor(size[::-1])
    return ((points > -0.5) & (points < size - 0.5)).all(-1)
