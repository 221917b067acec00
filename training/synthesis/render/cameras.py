"""Batches of cameras in torch."""

from __future__ import annotations

from dataclasses import dataclass, replace

import torch
from torch import Tensor


@dataclass(frozen=True)
class Cameras:
    """B pinhole cameras of one image size. OpenCV axes; pixel (0, 0) is the top-left's centre."""

    K: Tensor  # (B, 3, 3), pixels, without skew
    rotation: Tensor  # (B, 3, 3), camera from world
    translation: Tensor  # (B, 3), camera from world
    size: tuple[int, int]  # (width, height), pixels

    @classmethod
    def at(cls, centre: Tensor, K: Tensor, rotation: Tensor, size: tuple[int, int]) -> Cameras:
        """Cameras whose centres (B, 3) in the world are given."""
        return cls(K, rotation, -(rotation @ centre[..., None])[..., 0], size)

    @property
    def centre(self) -> Tensor:
        """Camera centres in the world, (B, 3)."""
        return -(self.rotation.mT @ self.translation[..., None])[..., 0]

    def pixels(self) -> Tensor:
        """The pixel centres row by row, (2, height * width)."""
        axes = (torch.arange(n, dtype=self.K.dtype, device=self.K.device) for n in self.size)
        return torch.stack(torch.meshgrid(*axes, indexing="xy")).flatten(1)

    def rays(self, pixels: Tensor) -> Tensor:
        """Directions in the camera of pixels (2, n), with z = 1: (B, 3, n)."""
        x = (pixels[0] - self.K[:, 0, 2, None]) / self.K[:, 0, 0, None]
        y = (pixels[1] - self.K[:, 1, 2, None]) / self.K[:, 1, 1, None]
        return torch.stack((x, y, torch.ones_like(x)), dim=1)

    def project(self, points: Tensor) -> Tensor:
        """Pixels (B, 2, n) of points (B, 3, n) of the camera frame; meaningless for z <= 0."""
        focal = self.K.diagonal(dim1=1, dim2=2)[:, :2, None]
        centre = self.K[:, :2, 2][..., None]
        return points[:, :2] / points[:, 2:] * focal + centre

    def shifted(self, x: float, y: float) -> Cameras:
        """The cameras whose pixel (0, 0) is this one's (x, y): for samples within a pixel."""
        offset = torch.zeros_like(self.K)
        offset[:, 0, 2], offset[:, 1, 2] = x, y
        return replace(self, K=self.K - offset)


def relative_pose(first: Cameras, second: Cameras) -> Tensor:
    """cam2_from_cam1, (B, 3, 4): x2 = R x1 + t, in the world's units."""
    rotation = second.rotation @ first.rotation.mT
    translation = second.translation[..., None] - rotation @ first.translation[..., None]
    return torch.cat((rotation, translation), dim=-1)


def look_at(centre: Tensor, target: Tensor) -> Tensor:
    """Rotations (B, 3, 3), camera from world, of cameras at `centre` facing `target` (B, 3).

    World y points down, and so does image y; undefined for a view straight up or down.
    """
    forward = torch.nn.functional.normalize(target - centre, dim=-1)
    down = torch.zeros_like(forward)
    down[..., 1] = 1
    right = torch.nn.functional.normalize(torch.linalg.cross(down, forward), dim=-1)
    return torch.stack((right, torch.linalg.cross(forward, right), forward), dim=-2)


def axis_angle(axis: Tensor, angle: Tensor) -> Tensor:
    """Rotations (..., 3, 3) about unit axes (..., 3) by angles (...) in radians (Rodrigues)."""
    x, y, z = axis.unbind(-1)
    zero = torch.zeros_like(x)
    cross = torch.stack((zero, -z, y, z, zero, -x, -y, x, zero), dim=-1).unflatten(-1, (3, 3))
    identity = torch.eye(3, dtype=axis.dtype, device=axis.device)
    sine, cosine = angle.sin()[..., None, None], angle.cos()[..., None, None]
    return identity + sine * cross + (1 - cosine) * (cross @ cross)
