"""Random warps against float64 references and the ranges they promise."""

import cv2
import numpy as np
import pytest
import torch
from scipy.interpolate import RBFInterpolator

from dgc_pose.benchmarks.warps import (
    TPS_KNOTS,
    affine_warp,
    apply_homography,
    homography_from_corners,
    homography_warp,
    thin_plate_spline,
)
from dgc_pose.training.draw import Draw

_CORNERS = torch.tensor([[-1.0, -1.0], [1.0, -1.0], [1.0, 1.0], [-1.0, 1.0]])


def test_homography_takes_corners_to_corners() -> None:
    shift = 0.5 * torch.rand(6, 4, 2, generator=torch.Generator().manual_seed(2)) - 0.25
    matrix = homography_from_corners(_CORNERS + shift)
    moved = apply_homography(matrix, _CORNERS.repeat(6, 1, 1))
    torch.testing.assert_close(moved, _CORNERS + shift, atol=1e-5, rtol=0)


def test_points_beyond_the_horizon_are_far_away_not_mirrored() -> None:
    matrix = torch.tensor([[[1.0, 0, 0], [0, 1, 0], [2, 0, 1]]])  # depth 1 + 2 x
    far = apply_homography(matrix, torch.tensor([[[-0.9, 0.3]]]))
    assert (far.abs() >= 1e5).all()


def test_affine_ranges_are_the_papers() -> None:
    points = torch.tensor([[[0.0, 0.0], [1.0, 0.0], [0.0, 1.0]]]).repeat(400, 1, 1)
    moved = affine_warp(400, Draw("cpu", 3))(points)
    linear = torch.stack([moved[:, 1] - moved[:, 0], moved[:, 2] - moved[:, 0]], -1)
    values = torch.linalg.svdvals(linear)
    assert 0.75 - 1e-4 < values.min() < 0.78 and 1.22 < values.max() < 1.25 + 1e-4
    left, _, right = torch.linalg.svd(linear)
    turn = left @ right
    angle = torch.rad2deg(torch.atan2(turn[:, 1, 0], turn[:, 0, 0]))
    assert 13 < angle.abs().max() < 15 + 1e-3
    assert 0.2 < moved[:, 0].abs().max() < 0.25 + 1e-4


def test_homography_of_the_paper_moves_the_corners_by_at_most_80_of_240_pixels() -> None:
    points = (0.1 * _CORNERS).repeat(300, 1, 1)
    moved = homography_warp(300, Draw("cpu", 4))(points)
    corners = _CORNERS.double().numpy()[None]
    largest = []
    for index in range(300):
        # The map is the inverse of the homography that moves the corners.
        inverse, _ = cv2.findHomography(moved[index].numpy(), points[index].numpy())
        shift = cv2.perspectiveTransform(corners, inverse) - corners
        largest.append(np.abs(shift).max())
    assert np.quantile(largest, 0.99) < 2 / 3 + 0.01
    assert np.quantile(largest, 0.5) > 0.5


@pytest.mark.parametrize("spread", [0.0, 0.2, 1.0])
def test_a_spline_is_scipys(spread: float) -> None:
    rng = np.random.default_rng(3)
    knots = TPS_KNOTS.double().numpy()
    values = knots + spread * rng.normal(size=(4, 9, 2))
    points = rng.uniform(-1.5, 1.5, (4, 50, 2))
    spline = thin_plate_spline(TPS_KNOTS.double(), torch.from_numpy(values))
    found = spline(torch.from_numpy(points)).numpy()
    for own, targets, places in zip(found, values, points, strict=True):
        expected = RBFInterpolator(knots, targets, kernel="thin_plate_spline", degree=1)(places)
        np.testing.assert_allclose(own, expected, atol=1e-9)
