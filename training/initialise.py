"""Initialising a run's encoder from ImageNet's VGG-16."""

from pathlib import Path

from torch import nn

from dgc_pose.network.net import DGCNet
from dgc_pose.network.pyramid import Pyramid
from dgc_pose.network.weights import check_tensors, read_state


def initialise_encoder(weights: str | Path, net: DGCNet) -> None:
    """Load ImageNet's VGG-16 (.pth or .safetensors) in torchvision's layout (BSD-3-Clause), whose
    later layers are left out, into the net's encoder. It is not needed to run.

    Raises WeightsError if the file holds other weights.
    """
    assert isinstance(net.pyramid, Pyramid)
    path, layers = Path(weights), nn.ModuleDict({"features": vgg_layers(net.pyramid)})
    wanted, found = layers.state_dict(), read_state(Path(weights))
    state = {key: value for key, value in found.items() if key in wanted}
    check_tensors(path, "VGG-16 in torchvision's layout", state, wanted)
    layers.load_state_dict(state)


def vgg_layers(pyramid: Pyramid) -> nn.Sequential:
    """The pyramid's layers, all levels', as torchvision numbers those of VGG-16's `features`."""
    return nn.Sequential(*(layer for level in pyramid.children() for layer in level.children()))
