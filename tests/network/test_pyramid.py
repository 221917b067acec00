"""The pyramid: residual blocks against a loop, and batch norm folded without a trace."""

from __future__ import annotations

from dataclasses import replace

import torch
import torch.nn.functional as F
from torch import nn

from dgc_pose.network.config import preset
from dgc_pose.network.plain import Residual
from dgc_pose.network.pyramid import Pyramid, fold_batch_norm


def test_a_residual_block_adds_its_two_convolutions_to_what_came_in() -> None:
    torch.manual_seed(0)
    block = Residual(6, dilation=2, batch_norm=False).double()
    features = torch.randn(2, 6, 9, 7, dtype=torch.float64)
    first, second = (m for m in block.modules() if isinstance(m, nn.Conv2d))
    inner = F.conv2d(features, first.weight, first.bias, padding=1).clamp(min=0)
    outer = F.conv2d(inner, second.weight, second.bias, padding=2, dilation=2)
    assert torch.allclose(block(features), (features + outer).clamp(min=0), atol=1e-12)


def test_batch_norm_folds_without_a_trace() -> None:
    torch.manual_seed(0)
    config = preset("dgcm-lite")
    trained = Pyramid(replace(config, pyramid_batch_norm=True))
    for module in trained.modules():
        if isinstance(module, nn.BatchNorm2d):
            nn.init.uniform_(module.weight, 0.5, 1.5)
            nn.init.normal_(module.bias)
            nn.init.normal_(module.running_mean)
            nn.init.uniform_(module.running_var, 0.5, 2.0)
    plain = Pyramid(config)
    fold_batch_norm(trained, plain)
    assert trained.training, "folding must leave the trained pyramid as it was"
    image = torch.rand(1, 3, 48, 48)
    trained.eval()
    with torch.no_grad():
        for expected, folded in zip(trained(image), plain(image), strict=True):
            assert torch.allclose(folded, expected, rtol=1e-3, atol=1e-4 * expected.abs().max())
