"""Thin-plate splines of the plane."""

from collections.abc import Callable

import torch
import torch.nn.functional as F
from torch import Tensor

Warp = Callable[[Tensor], Tensor]  # points (B, N, 2) to points (B, N, 2)
TPS_KNOTS = torch.cartesian_prod(*[torch.linspace(-1, 1, 3)] * 2)  # a spline's control points


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
