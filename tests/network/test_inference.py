"""A network made for inference gives the maps of the one it was made from."""

from importlib import resources

import pytest
import torch
from torch import nn

from dgc_pose.images.image import load_image
from dgc_pose.network.config import preset
from dgc_pose.network.net import DGCNet
from dgc_pose.network.weights import load_network, shipped
from dgc_pose.runtime.torch_engine import for_inference, network_input


def _net(name: str) -> DGCNet:
    """Random weights, with running statistics of batch norm that are not 0 and 1."""
    torch.manual_seed(0)
    net = DGCNet(preset(name)).eval()
    for module in net.modules():
        if isinstance(module, nn.BatchNorm2d):
            nn.init.normal_(module.running_mean, 0.0, 0.1)
            nn.init.uniform_(module.running_var, 0.5, 1.5)
            nn.init.uniform_(module.weight, 0.5, 1.5)
    return net


@pytest.mark.parametrize("name", ["dgcm", "dgcm-lite0"])
def test_the_same_map(name):
    # Random features are all but alike, and their first correlation peak a matter of rounding.
    net = load_network(name) if name in shipped() else _net(name)
    fast = for_inference(net)
    assert nn.BatchNorm2d not in [type(module) for module in fast.modules()]
    folder = resources.files("dgc_pose") / "data" / "rendered"
    images = [load_image(str(folder / f"image{number}.jpg")).pixels for number in (1, 2)]
    inputs = [network_input(pixels, (240, 240), torch.device("cpu")) for pixels in images]
    with torch.inference_mode():
        wanted, found = net(*inputs), fast(*inputs)
    apart_px = 120 * (found.maps[-1] - wanted.maps[-1]).norm(dim=1)
    assert wanted.maps[-1].std() > 1e-3  # a map that is the same everywhere would show nothing
    assert apart_px.median() < 1e-3 and apart_px.quantile(0.99) < 0.05
    assert len(found.logits) == len(wanted.logits)
    # As probabilities: a logit of -10 carries a hundredth of rounding, which means nothing.
    off = (found.logits[-1].sigmoid() - wanted.logits[-1].sigmoid()).abs()[:, 0]
    # On image 1's border warped features fade, and their norm magnifies it.
    from_border_px = 120 * (wanted.maps[-1].abs().amax(1) - 1).abs()
    assert off[from_border_px > 2].max() < 1e-3
    assert off.quantile(0.999) < 1e-4 and off.max() < 1e-2
