"""The losses against loops written out here; a stage's loss falls, and only what it trains
changes."""

import math

import pytest
import torch
import torch.nn.functional as F
from map_nets import SMALL
from textures import drawn_photos
from torch import nn

from dgc_pose.network.config import preset
from dgc_pose.network.correlation import match_scores
from dgc_pose.network.net import DGCNet, global_correlation, l2_normalise
from dgc_pose.training.draw import Draw
from dgc_pose.training.losses import (
    DecoderStage,
    EncoderStage,
    _window,
    likelihood_loss,
    map_loss,
    mask_loss,
    window_loss,
)
from dgc_pose.training.pairs import warped_pairs
from dgc_pose.training.views import MapPairs, Shape


def test_the_likelihood_of_matches_equals_its_definition():
    generator = torch.Generator().manual_seed(0)
    (rows, columns), stride, scale = (4, 5), 8, 7.0
    source, target = l2_normalise(torch.randn(2, 6, rows, columns, generator=generator))[:, None]
    truth = torch.rand(1, 20, 2, generator=generator) * torch.tensor([39.0, 31.0])
    valid = torch.rand(1, 20, generator=generator) < 0.7
    truth[~valid] = torch.nan  # reaches neither the loss nor the gradient
    source.requires_grad_()
    likely = match_scores(scale * global_correlation(source, target).flatten(2)) / 2
    loss, share = likelihood_loss(likely, truth, valid, stride, (rows, columns))
    assert torch.autograd.grad(loss, source)[0].isfinite().all()
    total, near = 0.0, 0
    cells = [(x, y) for x in range(columns) for y in range(rows)]
    logits = {
        (x, y, t): scale * (source[0, :, y, x] @ target[0, :, t // columns, t % columns]).item()
        for x, y in cells
        for t in range(20)
    }
    for t in valid[0].nonzero()[:, 0].tolist():
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
    assert math.isclose(loss.item(), total / count, rel_tol=1e-4)
    assert math.isclose(float(share), near / count, rel_tol=1e-6)


def test_the_window_loss_is_least_for_features_that_find_the_truth():
    """Of a shift by whole cells of the means, against a loop; and by less than with another."""
    generator = torch.Generator().manual_seed(1)
    wide = l2_normalise(torch.randn(1, 32, 28, 36, generator=generator))
    smooth = l2_normalise(F.avg_pool2d(wide, 3, 1))
    source, target = smooth[:, :, :24, :32], smooth[:, :, 2:26, 1:33]
    y, x = torch.meshgrid(torch.arange(12.0), torch.arange(16.0), indexing="ij")
    truth = 8 * torch.stack([x, y], -1).view(1, -1, 2) + 3.5 + torch.tensor([4.0, 8.0])
    valid = ((truth > 16) & (truth < torch.tensor([128.0, 96.0]) - 16)).all(-1)
    losses = [
        float(window_loss(source, target, truth + shift, valid, Draw("cpu", 0), 500))
        for shift in (0.0, 4.0)
    ]
    means, wanted = F.avg_pool2d(source, 2, 1)[0], F.avg_pool2d(target, 2)[0]
    expected = []
    for t in valid[0].nonzero()[:, 0].tolist():
        row, column = t // 16, t % 16
        window = means[:, 2 * row - 1 : 2 * row + 6, 2 * column - 2 : 2 * column + 5]
        scores = 20 * torch.einsum("chw,c->hw", window, wanted[:, row, column])
        expected.append(float(scores.logsumexp((0, 1)) - scores[3, 3]))
    # The loss draws the windows, which the loop has in the middle.
    assert 40 < len(expected) < 160
    assert math.isclose(losses[0], sum(expected) / len(expected), rel_tol=0.15)
    assert losses[1] > 2 * losses[0]


def test_map_and_mask_losses_are_means_over_the_cells_that_count():
    error = torch.tensor([[[[1.0, -2.0], [3.0, 0.0]], [[torch.nan, 1.0], [0.5, 0.5]]]])
    valid = torch.tensor([[[True, True], [False, True]]])
    expected = sum(4 * math.log1p(e / 4) for e in (3, 3, 1)) / 3
    assert math.isclose(float(map_loss(error, valid)), expected, rel_tol=1e-6)
    assert float(map_loss(error, torch.zeros_like(valid))) == 0.0
    logits = torch.tensor([[[[0.3, -1.2, 5.0]]]])
    target = torch.tensor([[[True, False, False]]])
    known = torch.tensor([[[True, True, False]]])
    cross_entropy = F.softplus(torch.tensor([-0.3, -1.2])).mean()
    torch.testing.assert_close(mask_loss(logits, target, known), cross_entropy)


def _pairs(count: int, shape: Shape) -> MapPairs:
    pairs = warped_pairs(drawn_photos(6, 96), count, shape, Draw("cpu", 0), light=False)
    return pairs._replace(valid=pairs.valid & pairs.known)


def _losses(stage: nn.Module, pairs: MapPairs, steps: int, rate: float) -> tuple[list[float], set]:
    trained = [parameter for parameter in stage.parameters() if parameter.requires_grad]
    optimizer = torch.optim.AdamW(trained, lr=rate)
    losses = []
    for _ in range(steps):
        loss, figures = stage(pairs, Draw("cpu", 1), 0.0)
        optimizer.zero_grad()
        loss.backward()
        optimizer.step()
        losses.append(float(loss.detach()))
    return losses, set(figures)


@pytest.mark.slow
def test_the_encoders_loss_falls_on_views_that_are_no_squares():
    torch.manual_seed(0)
    net = DGCNet(preset("dgcm-lite0"))
    stage = EncoderStage(net)
    before = {key: value.clone() for key, value in net.state_dict().items()}
    with torch.no_grad():
        stage.finished()
    for key, value in net.state_dict().items():
        torch.testing.assert_close(value, before[key])
    losses, figures = _losses(stage.train(), _pairs(2, (96, 128)), 14, 2e-3)
    assert losses[-1] < 0.9 * losses[0]
    assert figures == {"found16", "agreed16", "found8", "found4"}
    stage.finished()
    changed = {k for k, v in net.state_dict().items() if not torch.equal(v, before[k])}
    assert "correlation_scales" in changed
    assert {k.split(".")[1] for k in changed if k.startswith("pyramid.")} >= {"stem", "head_4"}
    assert not any(k.startswith(("reg_", "pyramid.level_")) for k in changed)


@pytest.mark.slow
def test_the_decoders_loss_falls_and_the_pyramid_stays():
    torch.manual_seed(0)
    net = DGCNet(preset("dgcm-lite0"))
    before = {key: value.clone() for key, value in net.pyramid.state_dict().items()}
    losses, figures = _losses(DecoderStage(net).train(), _pairs(1, (176, 336)), 9, 1e-3)
    assert losses[-1] < losses[0]
    assert figures == {"epe15", "epe30", "epe60", "epe120", "epe240"}
    for key, value in net.pyramid.state_dict().items():
        assert torch.equal(value, before[key])


@pytest.mark.slow
def test_only_the_papers_decoders_learn_from_the_levels_after_them():
    for net, reached in ((DGCNet(preset("dgcm-lite0")), False), (DGCNet(SMALL), True)):
        stage = DecoderStage(net).train()
        gradients = []
        for scale in (1.0, 3.0):
            nn.init.constant_(net.get_submodule("reg_0.final").bias, scale)
            net.zero_grad()
            stage(_pairs(1, (240, 240)), Draw("cpu", 0), 1.0)[0].backward()
            gradients.append(net.get_submodule("reg_1.final").weight.grad.clone())
        assert torch.equal(*gradients) != reached


def test_the_noised_truth_is_near_the_truth(monkeypatch):
    """With the true map as input and untrained corrections, fine levels start within two cells."""
    net = DGCNet(preset("dgcm-lite0")).eval()
    for level in range(5):
        torch.nn.init.zeros_(net.get_submodule(f"reg_{level}.final").weight)
        torch.nn.init.zeros_(net.get_submodule(f"reg_{level}.final").bias)
    monkeypatch.setattr(Draw, "chance", lambda self, *shape, share: torch.ones(shape).bool())
    with torch.no_grad():
        _, errors = DecoderStage(net).eval()(_pairs(2, (208, 272)), Draw("cpu", 1), 0.0)
    assert 0.2 < errors["epe240"] < 4 and 0.4 < errors["epe120"] < 8 and errors["epe15"] > 20


def test_the_finest_levels_are_decoded_everywhere_in_turn():
    shape, covered = (128, 448), torch.zeros(128, 448, dtype=torch.bool)
    for seed in range(60):
        draw = Draw("cpu", seed)
        corner = [draw.choice(range(side // 4 + 1)) for side in shape]
        fine, coarse = _window(0, shape, corner), _window(1, shape, corner)
        covered[fine] = True
        assert [(2 * s.start, 2 * s.stop) for s in coarse] == [(s.start, s.stop) for s in fine]
        assert [s.stop - s.start for s in fine] == [64, 224]
    assert covered.float().mean() > 0.85
    last = _window(0, shape, [side // 4 for side in shape])
    assert tuple(part.stop for part in last) == shape
