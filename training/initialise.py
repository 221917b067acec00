"""Initialising a run from trained weights instead of random ones."""

from pathlib import Path
from typing import cast

from torch import Tensor, nn

from dgc_pose.errors import WeightsError, reason
from dgc_pose.network.efficientnet import EfficientPyramid
from dgc_pose.network.net import DGCNet
from dgc_pose.network.pyramid import Pyramid
from dgc_pose.network.weights import check_tensors, load_network, read_state
from dgc_pose.training.imagenet import load_backbone, vgg_layers
from dgc_pose.training.options import InitPart


def initialise_from(weights: str | Path, net: DGCNet, part: InitPart = "all") -> None:
    """Load the weights of a file (or of a shipped name) into `net`.

    With part "encoder", or weights of another preset with the same pyramid (an ablation), only the
    pyramid and the correlation's temperatures are loaded. Raises WeightsError if the pyramids
    differ, too.
    """
    other = load_network(weights)
    if part == "all" and other.config == net.config:
        net.load_state_dict(other.state_dict())
        return
    if other.config.pyramid != net.config.pyramid:
        raise WeightsError(
            f"{weights}: weights of {other.config.name}, whose pyramid {net.config.name} lacks"
        )
    net.pyramid.load_state_dict(other.pyramid.state_dict())
    if net.config.any_shape and other.config.any_shape:
        cast(Tensor, net.correlation_scales).copy_(cast(Tensor, other.correlation_scales))


def initialise_encoder(weights: str | Path, net: DGCNet, images: Tensor) -> None:
    """Load ImageNet's weights (.pth or .safetensors) into the net's encoder.

    VGG-16 in torchvision's layout, whose later layers are left out, or EfficientNet-Lite0. images:
    (B, 3, S, S), normalised, as for `load_backbone`. Raises WeightsError if the file holds other
    weights.
    """
    path = Path(weights)
    state = read_state(path, images.device)
    if isinstance(net.pyramid, Pyramid):
        layers = nn.ModuleDict({"features": vgg_layers(net.pyramid)})
        wanted = layers.state_dict()
        state = {key: value for key, value in state.items() if key in wanted}
        check_tensors(path, "VGG-16 in torchvision's layout", state, wanted)
        layers.load_state_dict(state)
        return
    assert isinstance(net.pyramid, EfficientPyramid)
    try:
        load_backbone(net.pyramid, state, images)
    except (LookupError, RuntimeError) as error:
        what = "not weights of EfficientNet-Lite0"
        raise WeightsError(f"{path}: {what} ({reason(error)})") from error
