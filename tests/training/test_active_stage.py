"""The active stage: learning rates by group of parameters."""

from __future__ import annotations

import pytest
import torch
from map_nets import SMALL

from dgc_pose.network.config import preset
from dgc_pose.network.net import DGCNet
from dgc_pose.training.active_stage import ActiveStage
from dgc_pose.training.options import RunOptions


def test_a_backbone_learns_at_a_quarter_of_the_rate() -> None:
    net = DGCNet(preset("dgcm-lite0"))
    stage = ActiveStage("encoder", net, RunOptions("dgcm-lite0", 1.0), torch.randn(1, 3, 32, 32))
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


def test_a_network_without_backbone_has_one_rate() -> None:
    net = DGCNet(SMALL)
    stage = ActiveStage("encoder", net, RunOptions("dgcm-lite0", 1.0), torch.randn(1, 3, 32, 32))
    rate = stage.set_rate(0.5)
    assert [group["lr"] for group in stage.optimizer.param_groups] == [rate]
