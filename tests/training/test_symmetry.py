"""The symmetries of a square: features, points and transformations move together."""

import numpy as np
import pytest
import torch

from dgc_pose.network.config import preset
from dgc_pose.network.geometric_net import GeometricNet
from dgc_pose.network.spline import TPS_KNOTS
from dgc_pose.training.symmetry import SYMMETRIES, Symmetry, brought_back, moved


@pytest.mark.parametrize("symmetry", SYMMETRIES, ids=str)
def test_a_symmetry_moves_features_as_points_and_brings_transformations_back(
    symmetry: Symmetry,
) -> None:
    net = GeometricNet(preset("rocco"))
    rng = np.random.default_rng(6)
    affine = torch.from_numpy(np.eye(3)[None, :2] + 0.2 * rng.normal(size=(1, 2, 3)))
    spline = TPS_KNOTS.double() + 0.2 * torch.from_numpy(rng.normal(size=(1, 9, 2)))
    matrix = symmetry.matrix.double()
    torch.testing.assert_close(matrix @ matrix.T, torch.eye(2).double())
    # A map's two channels at the moved cells, moved too: the same map seen by the symmetry.
    for bent in (None, spline):
        seen = net.dense_map(affine, bent, 15)
        back = net.dense_map(
            symmetry.affine(affine), None if bent is None else symmetry.spline(bent), 15
        )
        moved = torch.einsum("ij,bjhw->bihw", matrix, symmetry.features(back))
        torch.testing.assert_close(moved, seen, atol=1e-9, rtol=0)


def test_symmetries_are_eight() -> None:
    assert len({tuple(symmetry.matrix.ravel().tolist()) for symmetry in SYMMETRIES}) == 8


def test_what_is_estimated_of_moved_features_is_brought_back_in_their_order() -> None:
    views = SYMMETRIES[1:4]
    features = torch.rand(2, 3, 15, 15)
    assert torch.equal(moved(views, features)[2:4], views[1].features(features))
    affine = torch.rand(2, 2, 3)
    seen = [_moved_affine(view, affine) for view in views]
    torch.testing.assert_close(
        brought_back(views, Symmetry.affine, torch.cat(seen)), affine.repeat(3, 1, 1)
    )


def _moved_affine(view: Symmetry, affine: torch.Tensor) -> torch.Tensor:
    matrix = view.matrix
    return torch.cat([matrix @ affine[:, :, :2] @ matrix.T, matrix @ affine[:, :, 2:]], 2)
