"""Initialising a run's encoder from ImageNet's VGG-16."""

from pathlib import Path

import torch
from torch import nn

from dgc_pose.network.net import DGCNet
from dgc_pose.network.pyramid import Pyramid
from dgc_pose.network.stored import check_state
from dgc_pose.network.weights import read_state


def initialise_encoder(weights: str | Path, net: DGCNet) -> None:
    """Load ImageNet's VGG-16 (.pth or .safetensors) in torchvision's layout (BSD-3-Clause), whose
    later layers are left out, into the net's encoder. It is not needed to run.

    Raises WeightsError if the file holds other weights.
    """
    assert isinstance(net.pyramid, Pyramid)
    path, layers = Path(weights), nn.ModuleDict({"features": vgg_layers(net.pyramid)})
    wanted = {key: value.shape for key, value in layers.state_dict().items()}
    state = {key: value for key, value in read_state(path).items() if key in wanted}
    check_state(path, "VGG-16 in torchvision's layout", state, wanted)
    layers.load_state_dict({key: torch.from_numpy(value) for key, value in state.items()})


def vgg_layers(pyramid: Pyramid) -> nn.Sequential:
    """The pyramid's layers, all levels', as torchvision numbers those of VGG-16's `features`."""
    return nn.Sequential(*(layer for level in pyramid.children() for layer in level.children()))
