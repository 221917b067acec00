"""Neighbourhood consensus against belief propagation written out in loops."""

import math

import numpy as np
import pytest
import torch

from dgc_pose.network import constants as module
from dgc_pose.network.correlation import consensus, peaks


def _loops(scores: np.ndarray, passes: int) -> np.ndarray:
    """The same for scores[xs, ys, yt, xt], cell by cell."""
    width, height = scores.shape[:2]
    cells = [(y, x) for y in range(height) for x in range(width)]

    def normalised(values: np.ndarray) -> np.ndarray:
        return values - np.log(np.exp(values).sum((0, 1)))

    belief = normalised(scores)
    for _ in range(passes):
        messages = np.empty_like(belief)
        for yt, xt in cells:
            for ys, xs in cells:
                total = 0.0
                for y, x in cells:
                    square = ((y - ys) ** 2 + (x - xs) ** 2) / module.REACH**2
                    density = math.exp(-square / 2) / (2 * math.pi * module.REACH**2)
                    total += density * math.exp(belief[x, y, yt, xt])
                messages[xs, ys, yt, xt] = math.log(total + module.FLOOR)
        updated = scores.copy()
        for yt, xt in cells:
            for ys, xs in cells:
                for dy in (-1, 0, 1):
                    for dx in (-1, 0, 1):
                        if (dy, dx) == (0, 0) or (yt + dy, xt + dx) not in cells:
                            continue
                        message = math.log(module.FLOOR)
                        if (ys + dy, xs + dx) in cells:
                            message = messages[xs + dx, ys + dy, yt + dy, xt + dx]
                        updated[xs, ys, yt, xt] += module.WEIGHT * message
        belief = normalised(updated)
    return belief


@pytest.mark.parametrize("passes", [0, 1, 3])
def test_belief_is_that_of_the_loops(passes: int) -> None:
    generator = torch.Generator().manual_seed(3)
    scores = 4 * torch.randn(2, 12, 3, 4, generator=generator, dtype=torch.float64)
    found = consensus(scores, passes)
    for pair in range(2):
        expected = _loops(scores[pair].view(4, 3, 3, 4).numpy(), passes)
        np.testing.assert_allclose(found[pair].view(4, 3, 3, 4).numpy(), expected, atol=1e-9)


def _scores(rotations: int, lost: tuple[slice, slice]) -> tuple[torch.Tensor, torch.Tensor]:
    """Scores of a view rotated by multiples of 90 degrees, and the truth (2, 15, 15).

    The cells in `lost` have only a weak wrong match in a corner.
    """
    rows, columns = torch.meshgrid(torch.arange(15), torch.arange(15), indexing="ij")
    x, y = torch.rot90(columns, rotations), torch.rot90(rows, rotations)
    scores = torch.zeros(1, 225, 15, 15)
    scores.scatter_(1, (x * 15 + y)[None, None], 8.0)
    scores[:, :, lost[0], lost[1]] = 0
    scores[:, 14, lost[0], lost[1]] = 1.0
    return scores, torch.stack([x, y])


@pytest.mark.parametrize(("rotations", "within"), [(0, 0.5), (1, 2.0), (2, 3.5), (3, 2.0)])
def test_neighbours_correct_wrong_cells(rotations: int, within: float) -> None:
    """Within what the blur allows: it is centred on the neighbours' matches in upright views."""
    scores, truth = _scores(rotations, (slice(6, 9), slice(6, 9)))
    before = (peaks(scores)[0][0] - truth).norm(dim=0)
    after = (peaks(consensus(scores, 4))[0][0] - truth).norm(dim=0)
    assert (before[6:9, 6:9] > 5).all()
    assert (after[6:9, 6:9] < within).all()
    assert (after < within).all()


def test_two_surfaces_stay_two() -> None:
    """A step between two motions moves neither side of it."""
    rows, columns = torch.meshgrid(torch.arange(15), torch.arange(15), indexing="ij")
    x = (columns + torch.where(columns < 7, 0, 4)).clamp(max=14)
    scores = torch.zeros(1, 225, 15, 15).scatter_(1, (x * 15 + rows)[None, None], 8.0)
    found = peaks(consensus(scores, 4))[0][0]
    assert (found - torch.stack([x, rows])).norm(dim=0)[:, :11].max() < 1


def test_the_gradient_is_finite() -> None:
    scores = torch.zeros(1, 225, 15, 15)
    scores[:, 0] = 100.0
    scores.requires_grad_()
    consensus(scores, 4).sum().backward()
    assert scores.grad is not None and torch.isfinite(scores.grad).all()
