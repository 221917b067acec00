"""The losses against loops written out here."""

import math

import torch
import torch.nn.functional as F

from dgc_pose.network.net import global_correlation, l2_normalise
from dgc_pose.training.losses import contrastive_loss, map_loss, mask_loss
from dgc_pose.training.map_pairs import level_truth


def _identity(size: int) -> torch.Tensor:
    axis = torch.arange(size, dtype=torch.float32)
    return torch.stack(torch.meshgrid(axis, axis, indexing="xy"), -1)[None]


def test_level_truth_is_the_map_at_the_cells_centres() -> None:
    """Of an affine map, the truth at a level is that map of the cells' centres, exactly."""
    truth = 0.8 * _identity(48) + 3.0
    for cells in (48, 24, 12, 3):
        stride = 48 // cells
        found, valid = level_truth(truth, torch.ones(1, 48, 48, dtype=torch.bool), cells)
        centres = (torch.arange(cells) + 0.5) * stride - 0.5
        assert valid.all()
        torch.testing.assert_close(found[0, 1, :, 0], 0.8 * centres + 3.0)
        torch.testing.assert_close(found[0, :, 1, 1], 0.8 * centres + 3.0)


def test_level_truth_leaves_out_edges_and_holes() -> None:
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


def test_contrastive_loss_equals_its_definition() -> None:
    generator = torch.Generator().manual_seed(0)
    size, stride, scale = 4, 8, 7.0
    source, target = l2_normalise(torch.randn(2, 1, 6, size, size, generator=generator))
    truth = 31 * torch.rand(1, size, size, 2, generator=generator)
    valid = torch.rand(1, size, size, generator=generator) < 0.7
    evidence = scale * global_correlation(source, target).flatten(2)
    loss, share = contrastive_loss(evidence, truth.flatten(1, 2), valid.flatten(1), stride)
    total, near = 0.0, 0
    logits = {
        (s, t): scale * float(source[0, :, s // size, s % size] @ target[0, :, t // size, t % size])
        for s in range(16)
        for t in range(16)
    }
    for t in range(16):
        if not valid[0, t // size, t % size]:
            continue
        x, y = (((truth[0, t // size, t % size] + 0.5) / stride - 0.5).clamp(0, size - 1)).tolist()
        x0, y0 = min(int(x), size - 2), min(int(y), size - 2)
        for dy in (0, 1):
            for dx in (0, 1):
                weight = (1 - abs(x - x0 - dx)) * (1 - abs(y - y0 - dy))
                s = (y0 + dy) * size + x0 + dx
                over_s = math.log(sum(math.exp(logits[k, t]) for k in range(16)))
                over_t = math.log(sum(math.exp(logits[s, k]) for k in range(16)))
                total -= weight * (2 * logits[s, t] - over_s - over_t) / 2
        best = max(range(16), key=lambda k: logits[k, t])
        bx, by = ((truth[0, t // size, t % size] + 0.5) / stride - 0.5).tolist()
        near += math.hypot(best % size - bx, best // size - by) < 1.5
    count = int(valid.sum())
    assert math.isclose(float(loss), total / count, rel_tol=1e-4)
    assert math.isclose(float(share), near / count, rel_tol=1e-6)


def test_map_loss_is_a_mean_over_valid_cells_of_logarithms() -> None:
    error = torch.tensor([[[[1.0, -2.0], [3.0, 0.0]], [[torch.nan, 1.0], [0.5, 0.5]]]])
    valid = torch.tensor([[[True, True], [False, True]]])
    expected = sum(4 * math.log1p(e / 4) for e in (3, 3, 1)) / 3
    assert math.isclose(float(map_loss(error, valid)), expected, rel_tol=1e-6)
    assert float(map_loss(error, torch.zeros_like(valid))) == 0.0


def test_nothing_flows_back_from_what_is_not_valid() -> None:
    """NaN in the truth where it does not hold reaches neither the loss nor the gradient."""
    source, target = torch.randn(2, 1, 6, 4, 4, requires_grad=True)
    truth = 31 * torch.rand(1, 4, 4, 2)
    valid = torch.rand(1, 4, 4) < 0.5
    truth[~valid] = torch.nan
    evidence = 7.0 * global_correlation(source, target).flatten(2)
    flat = truth.flatten(1, 2), valid.flatten(1)
    loss, share = contrastive_loss(evidence, *flat, 8)
    (gradient,) = torch.autograd.grad(loss, source)
    assert loss.isfinite() and share.isfinite() and gradient.isfinite().all()


def test_mask_loss_is_cross_entropy_where_the_truth_is_known() -> None:
    logits = torch.tensor([[[[0.3, -1.2, 5.0]]]])
    target = torch.tensor([[[True, False, False]]])
    known = torch.tensor([[[True, True, False]]])
    expected = F.softplus(torch.tensor([-0.3, -1.2])).mean()
    torch.testing.assert_close(mask_loss(logits, target, known), expected)
