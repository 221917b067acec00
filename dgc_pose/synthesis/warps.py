"""Random maps of the plane: affine, thin-plate-spline and homography (paper, section 4).

A warp takes points (B, N, 2) of the target view to points of the source view, both in normalised
coordinates where -1 and +1 are the outer edges of the view.
"""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import dataclass, replace

import torch
from torch import Tensor

from dgc_pose.errors import InputError

Warp = Callable[[Tensor], Tensor]
FAR = 1e6  # normalised; what lies beyond a homography's horizon is put there


@dataclass(frozen=True)
class WarpOptions:
    """Ranges of the random warps. The defaults are the paper's, measured on its lists."""

    affine_share: float = 0.25  # of the pairs
    tps_share: float = 0.25  # of the pairs; the rest are homographies
    singular_values: tuple[float, float] = (0.75, 1.25)  # of the affine's linear part
    affine_rotation_deg: float = 15.0  # uniform in +- this
    homography_rotation_deg: float = 0.0  # uniform in +- this, beside what the corners do
    any_rotation_share: float = 0.0  # of the affine and homography pairs: rotation in +-180 deg
    translation: float = 0.25  # uniform in +- this, normalised
    tps_sigma: float = 0.2  # of the control points, normalised
    corner_shift: float = 2 / 3  # of a homography's corners, normalised: 80 of 240 pixels
    homography_scale: tuple[float, float] = (1.0, 1.0)  # extra zoom of a homography, log-uniform

    def __post_init__(self) -> None:
        if min(self.affine_share, self.tps_share) < 0 or self.affine_share + self.tps_share > 1:
            raise InputError("affine_share and tps_share must be shares of one")
        if not 0 <= self.corner_shift < 1:
            raise InputError("corner_shift must lie in [0, 1): beyond, corners would cross")


PAPER = WarpOptions()
PAPER_AFFINE = replace(PAPER, affine_share=1.0, tps_share=0.0)
PAPER_AFFINE_TPS = replace(PAPER, affine_share=0.5, tps_share=0.5)
PAPER_HOMOGRAPHY = replace(PAPER, affine_share=0.0, tps_share=0.0)
WIDE = WarpOptions(
    affine_share=0.3,
    tps_share=0.15,
    singular_values=(0.5, 1.6),
    affine_rotation_deg=30.0,
    homography_rotation_deg=30.0,
    any_rotation_share=0.12,
    translation=0.35,
    tps_sigma=0.15,
    corner_shift=0.5,
    homography_scale=(0.6, 1.5),
)
WARPS = {
    "paper-affine": PAPER_AFFINE,
    "paper-affine-tps": PAPER_AFFINE_TPS,
    "paper-homography": PAPER_HOMOGRAPHY,
    "paper": PAPER,
    "wide": WIDE,
}


def random_warp(batch: int, options: WarpOptions, generator: torch.Generator) -> Warp:
    """One random warp a pair, of the kinds and ranges that the options name."""
    draw = _Draw(batch, generator)
    kind = draw.uniform(0, 1)
    is_affine = kind < options.affine_share
    is_tps = ~is_affine & (kind < options.affine_share + options.tps_share)
    affine = _random_affine(draw, options)
    knots, targets = _random_tps(draw, options)
    bent = is_tps.nonzero()[:, 0]
    spline = thin_plate_spline(knots, targets[bent])
    homography = _random_homography(draw, options)
    projective = torch.where(is_affine[:, None, None], affine, homography)

    def warp(points: Tensor) -> Tensor:
        # CPU draws; from pageable memory the copy is taken before the call returns.
        moved = apply_homography(projective.to(points, non_blocking=True), points)
        if not len(bent):
            return moved
        chosen = bent.to(points.device, non_blocking=True)
        return moved.index_copy(0, chosen, spline(points[chosen]))

    return warp


def apply_homography(matrix: Tensor, points: Tensor) -> Tensor:
    """Points (B, N, 2) through homographies (B, 3, 3); beyond the horizon they become FAR."""
    moved = points @ matrix[:, :, :2].transpose(1, 2) + matrix[:, None, :, 2]
    depth = moved[..., 2:]
    return torch.where(depth > 1e-6, moved[..., :2] / depth.clamp(min=1e-6), FAR).clamp(-FAR, FAR)


def thin_plate_spline(control: Tensor, values: Tensor) -> Warp:
    """The spline through control points (K, 2) to values (B, K, 2), exactly.

    Kernel r^2 log r^2, no regulariser.
    """
    count = len(control)
    kernel = _tps_kernel(torch.cdist(control, control))
    poly = torch.cat([control.new_ones(count, 1), control], 1)
    system = control.new_zeros(count + 3, count + 3)
    system[:count, :count] = kernel
    system[:count, count:] = poly
    system[count:, :count] = poly.T
    right = torch.cat([values, values.new_zeros(len(values), 3, 2)], 1)
    weights = torch.linalg.solve(system.double(), right.double()).to(values.dtype)

    def warp(points: Tensor) -> Tensor:
        knots = control.to(points, non_blocking=True).expand(len(points), -1, -1)
        basis = _tps_kernel(torch.cdist(points, knots))
        affine = torch.cat([torch.ones_like(points[..., :1]), points], -1)
        return torch.cat([basis, affine], -1) @ weights.to(points, non_blocking=True)

    return warp


def homography_from_corners(corners: Tensor) -> Tensor:
    """(B, 3, 3) that takes the corners (-1,-1), (1,-1), (1,1), (-1,1) to `corners` (B, 4, 2)."""
    base = corners.new_tensor([[-1, -1], [1, -1], [1, 1], [-1, 1]]).expand(len(corners), 4, 2)
    x, y = base.unbind(-1)
    u, v = corners.unbind(-1)
    one, zero = torch.ones_like(x), torch.zeros_like(x)
    rows_u = torch.stack([x, y, one, zero, zero, zero, -u * x, -u * y], -1)
    rows_v = torch.stack([zero, zero, zero, x, y, one, -v * x, -v * y], -1)
    system = torch.cat([rows_u, rows_v], 1).double()
    solution = torch.linalg.solve(system, torch.cat([u, v], 1).double()[..., None])[..., 0]
    ones = solution.new_ones(len(corners), 1)
    return torch.cat([solution, ones], 1).view(-1, 3, 3).to(corners.dtype)


class _Draw:
    """Random numbers for a batch, on the CPU so that a seed means the same on every device."""

    def __init__(self, batch: int, generator: torch.Generator) -> None:
        self.batch = batch
        self._generator = generator

    def uniform(self, low: float, high: float, *shape: int) -> Tensor:
        values = torch.rand(self.batch, *shape, generator=self._generator)
        return low + (high - low) * values

    def normal(self, *shape: int) -> Tensor:
        return torch.randn(self.batch, *shape, generator=self._generator)

    def log_uniform(self, limits: tuple[float, float], *shape: int) -> Tensor:
        return self.uniform(math.log(limits[0]), math.log(limits[1]), *shape).exp()


def _tps_kernel(distance: Tensor) -> Tensor:
    squared = distance.square()
    return squared * squared.clamp(min=1e-12).log()


def _rotation(angle: Tensor) -> Tensor:
    cos, sin = angle.cos(), angle.sin()
    return torch.stack([torch.stack([cos, -sin], -1), torch.stack([sin, cos], -1)], -2)


def _random_rotation(draw: _Draw, limit_deg: float, any_share: float) -> Tensor:
    limit = math.radians(limit_deg)
    usual = draw.uniform(-limit, limit)
    anyhow = draw.uniform(-math.pi, math.pi)
    return _rotation(torch.where(draw.uniform(0, 1) < any_share, anyhow, usual))


def _random_affine(draw: _Draw, options: WarpOptions) -> Tensor:
    axes = _rotation(draw.uniform(-math.pi, math.pi))
    stretch = torch.diag_embed(draw.log_uniform(options.singular_values, 2))
    turn = _random_rotation(draw, options.affine_rotation_deg, options.any_rotation_share)
    linear = turn @ axes @ stretch @ axes.transpose(1, 2)
    shift = draw.uniform(-options.translation, options.translation, 2)
    return _homogeneous(linear, shift)


def _homogeneous(linear: Tensor, shift: Tensor) -> Tensor:
    matrix = torch.eye(3).repeat(len(linear), 1, 1)
    matrix[:, :2, :2] = linear
    matrix[:, :2, 2] = shift
    return matrix


def _random_tps(draw: _Draw, options: WarpOptions) -> tuple[Tensor, Tensor]:
    """The control points (9, 2) and where they go (B, 9, 2)."""
    axis = torch.tensor([-1.0, 0.0, 1.0])
    control = torch.cartesian_prod(axis, axis)
    return control, control + options.tps_sigma * draw.normal(9, 2)


def _random_homography(draw: _Draw, options: WarpOptions) -> Tensor:
    corners = torch.tensor([[-1.0, -1.0], [1.0, -1.0], [1.0, 1.0], [-1.0, 1.0]])
    shift = draw.uniform(-options.corner_shift, options.corner_shift, 4, 2)
    # The lists hold the homography from source to target; the map runs the other way.
    matrix = torch.linalg.inv(homography_from_corners(corners + shift))
    turn = _random_rotation(draw, options.homography_rotation_deg, options.any_rotation_share)
    zoom = draw.log_uniform(options.homography_scale)[:, None, None]
    return matrix @ _homogeneous(turn * zoom, torch.zeros(draw.batch, 2))
