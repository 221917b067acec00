"""Random warps against float64 references and the ranges they promise."""

import cv2
import numpy as np
import torch

from dgc_pose.training.map_pairs import point_grid
from dgc_pose.training.synthesis.options import WarpOptions
from dgc_pose.training.synthesis.warps import apply_homography, homography_from_corners, random_warp

_CORNERS = torch.tensor([[-1.0, -1.0], [1.0, -1.0], [1.0, 1.0], [-1.0, 1.0]])


def _grid(batch: int, side: int = 9) -> torch.Tensor:
    return point_grid(torch.linspace(-1, 1, side)).repeat(batch, 1, 1)


def test_homography_takes_corners_to_corners() -> None:
    shift = 0.5 * torch.rand(6, 4, 2, generator=torch.Generator().manual_seed(2)) - 0.25
    matrix = homography_from_corners(_CORNERS + shift)
    moved = apply_homography(matrix, _CORNERS.repeat(6, 1, 1))
    torch.testing.assert_close(moved, _CORNERS + shift, atol=1e-5, rtol=0)


def test_points_beyond_the_horizon_are_far_away_not_mirrored() -> None:
    matrix = torch.tensor([[[1.0, 0, 0], [0, 1, 0], [2, 0, 1]]])  # depth 1 + 2 x
    far = apply_homography(matrix, torch.tensor([[[-0.9, 0.3]]]))
    assert (far.abs() >= 1e5).all()


def _linear_parts(options: WarpOptions, batch: int = 400) -> torch.Tensor:
    points = torch.tensor([[[0.0, 0.0], [1.0, 0.0], [0.0, 1.0]]]).repeat(batch, 1, 1)
    moved = random_warp(batch, options, torch.Generator().manual_seed(3))(points)
    return torch.stack([moved[:, 1] - moved[:, 0], moved[:, 2] - moved[:, 0]], -1)


def test_affine_ranges_are_the_papers() -> None:
    linear = _linear_parts(WarpOptions(affine_share=1.0, tps_share=0.0))
    values = torch.linalg.svdvals(linear)
    assert 0.75 - 1e-4 < values.min() < 0.78 and 1.22 < values.max() < 1.25 + 1e-4
    left, _, right = torch.linalg.svd(linear)
    turn = left @ right
    angle = torch.rad2deg(torch.atan2(turn[:, 1, 0], turn[:, 0, 0]))
    assert 13 < angle.abs().max() < 15 + 1e-3


def test_homography_of_the_paper_moves_the_corners_by_at_most_80_of_240_pixels() -> None:
    options = WarpOptions(affine_share=0.0, tps_share=0.0)
    points = 0.1 * _grid(300, 3)
    moved = random_warp(300, options, torch.Generator().manual_seed(4))(points)
    corners = _CORNERS.double().numpy()[None]
    largest = []
    for index in range(300):
        # The map is the inverse of the homography that moves the corners.
        inverse, _ = cv2.findHomography(moved[index].numpy(), points[index].numpy())
        shift = cv2.perspectiveTransform(corners, inverse) - corners
        largest.append(np.abs(shift).max())
    assert np.quantile(largest, 0.99) < 2 / 3 + 0.01
    assert np.quantile(largest, 0.5) > 0.5


def test_kinds_come_in_their_shares() -> None:
    """A map of straight lines that keeps parallels is affine, one that does not a homography."""
    points = torch.tensor([[[-0.6, 0.0], [0.0, 0.0], [0.6, 0.0]]]).repeat(2000, 1, 1)
    moved = random_warp(2000, WarpOptions(), torch.Generator().manual_seed(5))(points)
    first, second = moved[:, 1] - moved[:, 0], moved[:, 2] - moved[:, 1]
    affine = (first - second).norm(dim=-1) < 1e-4
    straight = (first[:, 0] * second[:, 1] - first[:, 1] * second[:, 0]).abs() < 1e-4
    assert abs(float(affine.float().mean()) - 0.25) < 0.04
    assert abs(float((~straight).float().mean()) - 0.25) < 0.04
