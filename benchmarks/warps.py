"""Random maps of the plane in the paper's ranges (section 4), measured on its lists.

A warp maps points (B, N, 2) of the target view to points of the source view, both in normalised
coordinates where -1 and +1 are the outer edges of the view.
"""

import math
from collections.abc import Callable

import cv2
import numpy as np
import torch
import torch.nn.functional as F
from torch import Tensor

from dgc_pose.training.draw import Draw
from dgc_pose.training.views import rotation_2d

Warp = Callable[[Tensor], Tensor]  # points (B, N, 2) to points (B, N, 2)
TPS_KNOTS = torch.cartesian_prod(*[torch.linspace(-1, 1, 3)] * 2)  # a spline's control points
FAR = 1e6  # normalised coordinate of points beyond a homography's horizon
_CORNERS = torch.tensor([[-1.0, -1.0], [1.0, -1.0], [1.0, 1.0], [-1.0, 1.0]])
_SINGULAR_VALUES = (0.75, 1.25)  # of the affine's linear part
_ROTATION = math.radians(15)  # of an affine map, uniform in +- this
_TRANSLATION = 0.25  # of an affine map, uniform in +- this
_TPS_SIGMA = 0.2  # of the control points
_CORNER_SHIFT = 2 / 3  # of a homography's corners: 80 of 240 pixels


def affine_warp(batch: int, draw: Draw) -> Warp:
    axes = rotation_2d(draw.uniform(batch, low=-math.pi, high=math.pi))
    low, high = _SINGULAR_VALUES
    stretch = torch.diag_embed(draw.log_uniform(batch, 2, low=low, high=high))
    turn = rotation_2d(draw.uniform(batch, low=-_ROTATION, high=_ROTATION))
    linear = turn @ axes @ stretch @ axes.mT
    shift = draw.uniform(batch, 1, 2, low=-_TRANSLATION, high=_TRANSLATION)
    return lambda points: points @ linear.mT + shift


def spline_warp(batch: int, draw: Draw) -> Warp:
    return thin_plate_spline(TPS_KNOTS, TPS_KNOTS + _TPS_SIGMA * draw.normal(batch, 9, 2))


def homography_warp(batch: int, draw: Draw) -> Warp:
    shift = draw.uniform(batch, 4, 2, low=-_CORNER_SHIFT, high=_CORNER_SHIFT)
    # The authors' lists hold the homography from source to target; the map is its inverse.
    matrix = torch.linalg.inv(homography_from_corners(_CORNERS + shift))
    return lambda points: apply_homography(matrix, points)


def apply_homography(matrix: Tensor, points: Tensor) -> Tensor:
    """Points (B, N, 2) through homographies (B, 3, 3); beyond the horizon they become FAR."""
    moved = F.pad(points, (0, 1), value=1.0) @ matrix.mT
    depth = moved[..., 2:]
    return torch.where(depth > 1e-6, moved[..., :2] / depth.clamp(min=1e-6), FAR).clamp(-FAR, FAR)


def homography_from_corners(corners: Tensor) -> Tensor:
    """(B, 3, 3) that maps the corners (-1,-1), (1,-1), (1,1), (-1,1) to `corners` (B, 4, 2)."""
    square = _CORNERS.numpy()
    matrices = [cv2.getPerspectiveTransform(square, moved.numpy()) for moved in corners]
    return torch.from_numpy(np.stack(matrices)).float()


def thin_plate_spline(control: Tensor, values: Tensor) -> Warp:
    """The spline through control points (K, 2) to values (B, K, 2), exactly.

    Kernel r^2 log r^2, no regulariser.
    """
    count = len(control)
    kernel = _kernel(torch.cdist(control, control))
    poly = F.pad(control, (1, 0), value=1.0)
    system = F.pad(kernel, (0, 3, 0, 3))
    system[:count, count:] = poly
    system[count:, :count] = poly.T
    right = F.pad(values, (0, 0, 0, 3))
    weights = torch.linalg.solve(system.double(), right.double()).to(values.dtype)

    def warp(points: Tensor) -> Tensor:
        basis = _kernel(torch.cdist(points, control.expand(len(points), -1, -1)))
        affine = F.pad(points, (1, 0), value=1.0)
        return torch.cat([basis, affine], -1) @ weights

    return warp


def _kernel(distance: Tensor) -> Tensor:
    squared = distance.square()
    return squared * squared.clamp(min=1e-12).log()
