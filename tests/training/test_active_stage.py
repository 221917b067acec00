"""The active stage: learning rates by group of parameters, and averaged weights."""

import pytest
from torch import nn

from dgc_pose.network.config import preset
from dgc_pose.network.net import DGCNet
from dgc_pose.training.active_stage import ActiveStage, moving_average
from dgc_pose.training.options import TrainingOptions


def _stage(net: DGCNet) -> ActiveStage:
    return ActiveStage("encoder", net, TrainingOptions(minutes=1.0))


def test_a_backbone_learns_at_a_quarter_of_the_rate() -> None:
    net = DGCNet(preset("dgcm-lite0"))
    stage = _stage(net)
    rate = stage.set_rate(0.5)
    rest, backbone = stage.optimizer.param_groups
    assert rest["lr"] == rate and backbone["lr"] == pytest.approx(rate / 4)
    body = [*net.pyramid.get_submodule("stem").parameters()]
    body += net.pyramid.get_submodule("blocks").parameters()
    shapes = [parameter.shape for parameter in backbone["params"]]
    assert shapes == [parameter.shape for parameter in body]
    # Levels 0 and 1 are frozen in this stage; all else is in one group or the other.
    fine = [net.pyramid.get_submodule(f"level_{level}") for level in (0, 1)]
    frozen = sum(p.numel() for level in fine for p in level.parameters())
    trained = sum(p.numel() for group in (rest, backbone) for p in group["params"])
    assert trained == sum(p.numel() for p in stage.module.parameters()) - frozen


@pytest.mark.parametrize("decay", [0.0, 0.3, 0.998])
def test_the_average_is_the_sum_of_all_values_by_their_decays(decay: float) -> None:
    """Of the weights, which lie between the values, and of the statistics; counters are copied."""
    norm = nn.BatchNorm1d(1)
    average = moving_average(norm, decay)
    expected, statistic = 1.0, 0.0  # as a norm begins
    for n, value in enumerate((0.5, 2.0, -1.0, 4.0, 1.5)):
        nn.init.constant_(norm.weight, value)
        nn.init.constant_(norm.get_buffer("running_mean"), -2 * value)
        norm.get_buffer("num_batches_tracked").fill_(n)
        average.update_parameters(norm)
        share = min(decay, (1 + n) / (10 + n))
        expected = share * expected + (1 - share) * value
        statistic = share * statistic + (1 - share) * -2 * value
    assert float(average.module.weight) == pytest.approx(expected, rel=1e-5)
    assert float(average.module.running_mean) == pytest.approx(statistic, rel=1e-5)
    assert int(average.module.num_batches_tracked) == 4
    assert not average.module.training and not average.module.weight.requires_grad
    assert norm.weight.requires_grad and norm.weight.item() == 1.5
