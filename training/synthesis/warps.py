"""Random maps of the plane: affine, thin-plate-spline and homography (paper, section 4).

A warp maps points (B, N, 2) of the target view to points of the source view, both in normalised
coordinates where -1 and +1 are the outer edges of the view.
"""

import math

import torch
import torch.nn.functional as F
from torch import Tensor

from dgc_pose.training.synthesis.draw import Draw
from dgc_pose.training.synthesis.options import WarpOptions
from dgc_pose.training.synthesis.spline import TPS_KNOTS, Warp, thin_plate_spline

FAR = 1e6  # normalised coordinate of points beyond a homography's horizon
_CORNERS = torch.tensor([[-1.0, -1.0], [1.0, -1.0], [1.0, 1.0], [-1.0, 1.0]])


def random_warp(batch: int, options: WarpOptions, generator: torch.Generator) -> Warp:
    """A random warp for each pair, of the kinds and ranges of the options.

    Drawn on the CPU, so that a seed means the same on every device.
    """
    draw = Draw(generator)
    kind = draw.uniform(batch)
    is_affine = kind < options.affine_share
    is_tps = ~is_affine & (kind < options.affine_share + options.tps_share)
    affine = _random_affine(draw, batch, options)
    targets = TPS_KNOTS + options.tps_sigma * draw.normal(batch, 9, 2)
    bent = is_tps.nonzero()[:, 0]
    spline = thin_plate_spline(TPS_KNOTS, targets[bent])
    homography = _random_homography(draw, batch, options)
    projective = torch.where(is_affine[:, None, None], affine, homography)

    def warp(points: Tensor) -> Tensor:
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


def homography_from_corners(corners: Tensor) -> Tensor:
    """(B, 3, 3) that maps the corners (-1,-1), (1,-1), (1,1), (-1,1) to `corners` (B, 4, 2)."""
    x, y = _CORNERS.expand(len(corners), 4, 2).unbind(-1)
    u, v = corners.unbind(-1)
    one, zero = torch.ones_like(x), torch.zeros_like(x)
    rows_u = torch.stack([x, y, one, zero, zero, zero, -u * x, -u * y], -1)
    rows_v = torch.stack([zero, zero, zero, x, y, one, -v * x, -v * y], -1)
    system = torch.cat([rows_u, rows_v], 1).double()
    solution = torch.linalg.solve(system, torch.cat([u, v], 1).double()[..., None])[..., 0]
    return F.pad(solution, (0, 1), value=1.0).view(-1, 3, 3).to(corners.dtype)


def rotation_2d(angle: Tensor) -> Tensor:
    """Rotations (B, 2, 2) by angles (B,), radians."""
    cos, sin = angle.cos(), angle.sin()
    return torch.stack([cos, -sin, sin, cos], -1).view(-1, 2, 2)


def _random_rotation(draw: Draw, batch: int, limit_deg: float, any_share: float) -> Tensor:
    limit = math.radians(limit_deg)
    usual = draw.uniform(batch, low=-limit, high=limit)
    full = draw.uniform(batch, low=-math.pi, high=math.pi)
    return rotation_2d(torch.where(draw.chance(batch, share=any_share), full, usual))


def _random_affine(draw: Draw, batch: int, options: WarpOptions) -> Tensor:
    axes = rotation_2d(draw.uniform(batch, low=-math.pi, high=math.pi))
    low, high = options.singular_values
    stretch = torch.diag_embed(draw.log_uniform(batch, 2, low=low, high=high))
    rotation = _random_rotation(
        draw, batch, options.affine_rotation_deg, options.any_rotation_share
    )
    matrix = torch.eye(3).repeat(batch, 1, 1)
    matrix[:, :2, :2] = rotation @ axes @ stretch @ axes.transpose(1, 2)
    matrix[:, :2, 2] = draw.uniform(batch, 2, low=-options.translation, high=options.translation)
    return matrix


def _random_homography(draw: Draw, batch: int, options: WarpOptions) -> Tensor:
    limit = options.corner_shift
    shift = draw.uniform(batch, 4, 2, low=-limit, high=limit)
    # The authors' lists hold the homography from source to target; the map is its inverse.
    matrix = torch.linalg.inv(homography_from_corners(_CORNERS + shift))
    rotation = _random_rotation(
        draw, batch, options.homography_rotation_deg, options.any_rotation_share
    )
    low, high = options.homography_scale
    scale = draw.log_uniform(batch, low=low, high=high)[:, None, None]
    similarity = torch.eye(3).repeat(batch, 1, 1)
    similarity[:, :2, :2] = rotation * scale
    return matrix @ similarity
