"""The stages: losses fall on a fixed batch, and only what a stage trains changes."""

import pytest
import torch
from map_nets import SMALL
from textures import drawn_photos
from torch import nn

from dgc_pose.network.config import preset
from dgc_pose.network.net import DGCNet
from dgc_pose.training.draw import Draw
from dgc_pose.training.losses import DecoderStage, EncoderStage, _window
from dgc_pose.training.pairs import warped_pairs
from dgc_pose.training.views import MapPairs, Shape

pytestmark = pytest.mark.slow


def _pairs(count: int, shape: Shape) -> MapPairs:
    pairs = warped_pairs(drawn_photos(6, 96), count, shape, Draw("cpu", 0), light=False)
    return MapPairs(pairs.image1, pairs.image2, pairs.map, pairs.valid & pairs.known, pairs.known)


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


def test_the_encoders_loss_falls_on_views_that_are_no_squares():
    torch.manual_seed(0)
    net = DGCNet(preset("dgcm-lite0"))
    stage = EncoderStage(net)
    before = {key: value.clone() for key, value in net.state_dict().items()}
    losses, figures = _losses(stage.train(), _pairs(2, (96, 128)), 14, 2e-3)
    assert losses[-1] < 0.9 * losses[0]
    assert figures == {"found16", "agreed16", "found8", "found4"}
    stage.finished()
    changed = {k for k, v in net.state_dict().items() if not torch.equal(v, before[k])}
    assert "correlation_scales" in changed
    assert {k.split(".")[1] for k in changed if k.startswith("pyramid.")} >= {"stem", "head_4"}
    assert not any(k.startswith(("reg_", "pyramid.level_")) for k in changed)


def test_a_trained_encoder_passes_through_its_stage_unchanged():
    torch.manual_seed(2)
    net = DGCNet(preset("dgcm-lite0"))
    net.get_buffer("correlation_scales").copy_(torch.tensor([33.0, 12.0]))
    before = {k: v.clone() for k, v in net.state_dict().items()}
    with torch.no_grad():
        EncoderStage(net).finished()
    for key, value in net.state_dict().items():
        torch.testing.assert_close(value, before[key])


@pytest.mark.parametrize(("name", "shape"), [("dgcm-lite0", (176, 336)), ("dgcm", (240, 240))])
def test_the_decoders_loss_falls_and_the_pyramid_stays(name, shape):
    torch.manual_seed(0)
    net = DGCNet(preset(name))
    before = {key: value.clone() for key, value in net.pyramid.state_dict().items()}
    losses, figures = _losses(DecoderStage(net).train(), _pairs(1, shape), 9, 1e-3)
    assert losses[-1] < losses[0]
    assert figures == {"epe15", "epe30", "epe60", "epe120", "epe240"}
    for key, value in net.pyramid.state_dict().items():
        assert torch.equal(value, before[key])


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
        rows, columns = _window(0, shape, corner)
        covered[rows, columns] = True
        coarse = _window(1, shape, corner)
        assert [(2 * s.start, 2 * s.stop) for s in coarse] == [
            (s.start, s.stop) for s in (rows, columns)
        ]
        assert (rows.stop - rows.start, columns.stop - columns.start) == (64, 224)
    assert covered.float().mean() > 0.85
    last = _window(0, shape, [side // 4 for side in shape])
    assert tuple(part.stop for part in last) == shape
