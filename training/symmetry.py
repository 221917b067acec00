"""The symmetries of a square, of features and of the transformations that are estimated of them."""

from __future__ import annotations

import itertools
from collections.abc import Callable, Sequence
from dataclasses import dataclass

import torch
from torch import Tensor

from dgc_pose.network.spline import TPS_KNOTS

_KNOTS = {tuple(knot): index for index, knot in enumerate(TPS_KNOTS.tolist())}


@dataclass(frozen=True)
class Symmetry:
    """Both axes exchanged or not, then each of them mirrored or not.

    Features of two images are moved; what is estimated of them is brought back.
    """

    exchanged: bool
    mirrored: tuple[bool, bool]  # x, y

    @property
    def matrix(self) -> Tensor:
        """(2, 2) that moves points."""
        matrix = torch.eye(2).flip(0) if self.exchanged else torch.eye(2)
        return torch.tensor([1.0 - 2.0 * one for one in self.mirrored])[:, None] * matrix

    def features(self, features: Tensor) -> Tensor:
        """Features (B, C, S, S), moved."""
        moved = features.transpose(2, 3) if self.exchanged else features
        return moved.flip([3 - axis for axis in (0, 1) if self.mirrored[axis]])

    def affine(self, affine: Tensor) -> Tensor:
        """Affine transformations (B, 2, 3) of moved points, brought back."""
        matrix = self.matrix.to(affine)
        return torch.cat([matrix.T @ affine[:, :, :2] @ matrix, matrix.T @ affine[:, :, 2:]], 2)

    def spline(self, values: Tensor) -> Tensor:
        """Values (B, 9, 2) at TPS_KNOTS of splines of moved points, brought back."""
        moved = [_KNOTS[tuple(knot)] for knot in (TPS_KNOTS @ self.matrix.T).tolist()]
        return values[:, moved] @ self.matrix.to(values)


SYMMETRIES = tuple(  # the first moves nothing
    Symmetry(exchanged, (mirrored_x, mirrored_y))
    for exchanged, mirrored_x, mirrored_y in itertools.product((False, True), repeat=3)
)


def moved(views: Sequence[Symmetry], features: Tensor) -> Tensor:
    """Features (B, C, S, S) by each of the symmetries: (len(views) * B, C, S, S)."""
    return torch.cat([view.features(features) for view in views])


def brought_back(
    views: Sequence[Symmetry], back: Callable[[Symmetry, Tensor], Tensor], values: Tensor
) -> Tensor:
    """The inverse for what is estimated of `moved`: each part of (len(views) * B, ...) by `back` of
    its symmetry."""
    parts = zip(views, values.chunk(len(views)), strict=True)
    return torch.cat([back(view, part) for view, part in parts])
