"""How a stage learns: rates by group of parameters, and averaged weights."""

import copy

import pytest
from torch import nn

from dgc_pose.network.config import preset
from dgc_pose.network.net import DGCNet
from dgc_pose.training.optimiser import move_average, optimiser
from dgc_pose.training.stages import EncoderStage


def test_a_backbone_learns_at_a_third_of_the_rate() -> None:
    net = DGCNet(preset("dgcm-lite0"))
    rest, backbone = optimiser(EncoderStage(net)).param_groups
    assert rest["share"] == 1 and backbone["share"] == 0.35
    body = [*net.pyramid.get_submodule("stem").parameters()]
    body += net.pyramid.get_submodule("blocks").parameters()
    shapes = [parameter.shape for parameter in backbone["params"]]
    assert shapes == [parameter.shape for parameter in body]
    # Levels 0 and 1 and the decoders stay in this stage; the temperatures are the stage's own.
    heads = [m for n, m in net.pyramid.named_children() if n.startswith(("head", "lift", "merge"))]
    trained = sum(p.numel() for group in (rest, backbone) for p in group["params"])
    own = sum(p.numel() for part in heads for p in part.parameters())
    assert trained == own + sum(p.numel() for p in body) + 4


@pytest.mark.parametrize("decay", [0.0, 0.3, 0.998])
def test_the_average_is_the_sum_of_all_values_by_their_decays(decay: float) -> None:
    """Of the weights, which lie between the values, and of the statistics; counters are copied."""
    norm = nn.BatchNorm1d(1)
    average = copy.deepcopy(norm)
    expected, statistic = 1.0, 0.0  # as a norm begins
    for n, value in enumerate((0.5, 2.0, -1.0, 4.0, 1.5)):
        nn.init.constant_(norm.weight, value)
        nn.init.constant_(norm.get_buffer("running_mean"), -2 * value)
        norm.get_buffer("num_batches_tracked").fill_(n)
        move_average(average, norm, n + 1, decay)
        share = min(decay, (1 + n) / (10 + n))
        expected = share * expected + (1 - share) * value
        statistic = share * statistic + (1 - share) * -2 * value
    assert average.weight.item() == pytest.approx(expected, rel=1e-5)
    assert average.running_mean.item() == pytest.approx(statistic, rel=1e-5)
    assert int(average.num_batches_tracked) == 4
    assert norm.weight.requires_grad and norm.weight.item() == 1.5
