"""The pyramid: batch norm folded without a trace."""

import torch
from map_nets import SMALL
from torch import nn

from dgc_pose.network.pyramid import Pyramid
from dgc_pose.training.stages import fold_batch_norm


def test_batch_norm_folds_without_a_trace() -> None:
    torch.manual_seed(0)
    trained = Pyramid(SMALL, batch_norm=True)
    for module in trained.modules():
        if isinstance(module, nn.BatchNorm2d):
            nn.init.uniform_(module.weight, 0.5, 1.5)
            nn.init.normal_(module.bias)
            nn.init.normal_(module.running_mean)
            nn.init.uniform_(module.running_var, 0.5, 2.0)
    plain = Pyramid(SMALL)
    fold_batch_norm(trained, plain)
    assert trained.training, "folding must leave the trained pyramid as it was"
    image = torch.rand(1, 3, 48, 48)
    trained.eval()
    with torch.no_grad():
        for expected, folded in zip(trained(image), plain(image), strict=True):
            assert torch.allclose(folded, expected, rtol=1e-3, atol=1e-4 * expected.abs().max())
