"""The losses against loops written out here."""

import math

import torch
import torch.nn.functional as F

from dgc_pose.network.correlation import match_scores
from dgc_pose.network.net import global_correlation, l2_normalise
from dgc_pose.training.draw import Draw
from dgc_pose.training.losses import (
    likelihood_loss,
    map_loss,
    mask_loss,
    window_loss,
)
from dgc_pose.training.views import level_truth


def _identity(size: int) -> torch.Tensor:
    axis = torch.arange(size, dtype=torch.float32)
    return torch.stack(torch.meshgrid(axis, axis, indexing="xy"), -1)[None]


def test_level_truth_is_the_map_at_the_cells_centres():
    """Of an affine map, the truth at a level is that map of the cells' centres, exactly."""
    truth = 0.8 * _identity(48) + 3.0
    for cells in (48, 24, 12, 3):
        stride = 48 // cells
        found, valid = level_truth(truth, torch.ones(1, 48, 48, dtype=torch.bool), cells)
        centres = (torch.arange(cells) + 0.5) * stride - 0.5
        assert valid.all()
        torch.testing.assert_close(found[0, 1, :, 0], 0.8 * centres + 3.0)
        torch.testing.assert_close(found[0, :, 1, 1], 0.8 * centres + 3.0)


def test_level_truth_leaves_out_edges_and_holes():
    truth, valid = _identity(16), torch.ones(1, 16, 16, dtype=torch.bool)
    valid[0, 3, 3] = False
    truth[0, :, 12:] += 50.0  # another surface, whose edge runs between cells
    _, whole = level_truth(truth, valid, 4)
    expected = torch.ones(4, 4, dtype=torch.bool)
    _, fine = level_truth(truth, valid, 8)
    assert torch.equal(whole[0], expected)  # neither is central at stride 4
    assert not fine[0, 1, 1] and int((~fine).sum()) == 1
    truth[0, :, 10:12] += 50.0  # and now through the middle of the cells of 4 pixels
    _, whole = level_truth(truth, valid, 4)
    assert not whole[0, :, 2].any() and whole[0, :, [0, 1, 3]].all()


def test_the_likelihood_of_matches_equals_its_definition():
    generator = torch.Generator().manual_seed(0)
    (rows, columns), stride, scale = (4, 5), 8, 7.0
    source, target = l2_normalise(torch.randn(2, 6, rows, columns, generator=generator))[:, None]
    truth = torch.rand(1, 20, 2, generator=generator) * torch.tensor([39.0, 31.0])
    valid = torch.rand(1, 20, generator=generator) < 0.7
    evidence = scale * global_correlation(source, target).flatten(2)
    likely = match_scores(evidence) / 2
    loss, share = likelihood_loss(likely, truth, valid, stride, (rows, columns))
    total, near = 0.0, 0
    logits = {
        (x, y, t): scale * float(source[0, :, y, x] @ target[0, :, t // columns, t % columns])
        for x in range(columns)
        for y in range(rows)
        for t in range(20)
    }
    cells = [(x, y) for x in range(columns) for y in range(rows)]
    for t in range(20):
        if not valid[0, t]:
            continue
        bx, by = ((truth[0, t] + 0.5) / stride - 0.5).tolist()
        x, y = min(max(bx, 0), columns - 1), min(max(by, 0), rows - 1)
        for cx, cy in cells:
            weight = max(0, 1 - abs(x - cx)) * max(0, 1 - abs(y - cy))
            over_s = math.log(sum(math.exp(logits[(*cell, t)]) for cell in cells))
            over_t = math.log(sum(math.exp(logits[cx, cy, k]) for k in range(20)))
            total -= weight * (2 * logits[cx, cy, t] - over_s - over_t) / 2
        best = max(cells, key=lambda cell: logits[(*cell, t)])
        near += math.hypot(best[0] - bx, best[1] - by) < 1.5
    count = int(valid.sum())
    assert math.isclose(float(loss), total / count, rel_tol=1e-4)
    assert math.isclose(float(share), near / count, rel_tol=1e-6)


def test_the_window_loss_is_least_for_features_that_find_the_truth():
    """Of a shift by whole cells of the means, against a loop; and by less than with another."""
    generator = torch.Generator().manual_seed(1)
    wide = l2_normalise(torch.randn(1, 32, 28, 36, generator=generator))
    smooth = l2_normalise(F.avg_pool2d(wide, 3, 1))
    source, target = smooth[:, :, :24, :32], smooth[:, :, 2:26, 1:33]
    y, x = torch.meshgrid(torch.arange(12.0), torch.arange(16.0), indexing="ij")
    centres = 8 * torch.stack([x, y], -1).view(1, -1, 2) + 3.5
    truth = centres + torch.tensor([4.0, 8.0])
    valid = ((truth > 16) & (truth < torch.tensor([128.0, 96.0]) - 16)).all(-1)
    assert 40 < valid.sum() < 160
    losses = [
        float(window_loss(source, target, (truth + shift, valid), Draw("cpu", 0), 500))
        for shift in (0.0, 4.0)
    ]
    means, wanted = F.avg_pool2d(source, 2, 1), F.avg_pool2d(target, 2)
    expected = []
    for t in valid[0].nonzero()[:, 0].tolist():
        row, column = t // 16, t % 16
        at = 2 * row + 2, 2 * column + 1
        scores = [
            20 * float(means[0, :, r, c] @ wanted[0, :, row, column])
            for r in range(at[0] - 3, at[0] + 4)
            for c in range(at[1] - 3, at[1] + 4)
        ]
        own = 20 * float(means[0, :, at[0], at[1]] @ wanted[0, :, row, column])
        expected.append(math.log(sum(map(math.exp, scores))) - own)
    # The loss draws the windows, which the loop has in the middle.
    assert math.isclose(losses[0], sum(expected) / len(expected), rel_tol=0.15)
    assert losses[1] > 2 * losses[0]


def test_map_loss_is_a_mean_over_valid_cells_of_logarithms():
    error = torch.tensor([[[[1.0, -2.0], [3.0, 0.0]], [[torch.nan, 1.0], [0.5, 0.5]]]])
    valid = torch.tensor([[[True, True], [False, True]]])
    expected = sum(4 * math.log1p(e / 4) for e in (3, 3, 1)) / 3
    assert math.isclose(float(map_loss(error, valid)), expected, rel_tol=1e-6)
    assert float(map_loss(error, torch.zeros_like(valid))) == 0.0


def test_nothing_flows_back_from_what_is_not_valid():
    """NaN in the truth where it does not hold reaches neither the loss nor the gradient."""
    source, target = torch.randn(2, 1, 6, 4, 4, requires_grad=True)
    truth, valid = 31 * torch.rand(1, 16, 2), torch.rand(1, 16) < 0.5
    truth[~valid] = torch.nan
    likely = match_scores(7.0 * global_correlation(source, target).flatten(2))
    loss, share = likelihood_loss(likely, truth, valid, 8, (4, 4))
    (gradient,) = torch.autograd.grad(loss, source)
    assert loss.isfinite() and share.isfinite() and gradient.isfinite().all()


def test_mask_loss_is_cross_entropy_where_the_truth_is_known():
    logits = torch.tensor([[[[0.3, -1.2, 5.0]]]])
    target = torch.tensor([[[True, False, False]]])
    known = torch.tensor([[[True, True, False]]])
    expected = F.softplus(torch.tensor([-0.3, -1.2])).mean()
    torch.testing.assert_close(mask_loss(logits, target, known), expected)
