"""Initialising a run from trained weights instead of random ones."""

from functools import partial
from pathlib import Path
from typing import cast

import torch
from torch import Tensor, nn

from dgc_pose.errors import WeightsError, reason
from dgc_pose.network.correspondence_net import CorrespondenceNet
from dgc_pose.network.efficientnet import EfficientPyramid
from dgc_pose.network.net import DGCNet
from dgc_pose.network.pyramid import Pyramid
from dgc_pose.network.weights import check_tensors, load_network, read_state
from dgc_pose.training.imagenet import load_backbone, vgg_layers
from dgc_pose.training.options import InitPart
from dgc_pose.training.stages import EncoderStage


def initialise_from(weights: str | Path, net: CorrespondenceNet, part: InitPart = "all") -> None:
    """Load the weights of a file (or of a shipped name) into `net`.

    With part "encoder", or weights of another preset with the same pyramid (an ablation), only the
    pyramid and the correlation's temperatures are loaded. Raises WeightsError if the pyramids
    differ, too, or if the encoder of `net` is given.
    """
    other = load_network(weights)
    if part == "all" and other.config == net.config:
        net.load_state_dict(other.state_dict())
        return
    if net.config.is_geometric:
        raise WeightsError(f"{weights}: {net.config.name} takes no other encoder")
    if other.config.pyramid != net.config.pyramid:
        raise WeightsError(
            f"{weights}: weights of {other.config.name}, whose pyramid {net.config.name} lacks"
        )
    net.pyramid.load_state_dict(other.pyramid.state_dict())
    if net.config.any_shape and other.config.any_shape:
        cast(Tensor, net.correlation_scales).copy_(cast(Tensor, other.correlation_scales))


def initialise_encoder(weights: str | Path, net: CorrespondenceNet, images: Tensor) -> None:
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


@torch.no_grad()
def initialise_stage(stage: EncoderStage, net: DGCNet, images: Tensor) -> None:
    """Load the net's pyramid and temperatures into the encoder's stage.

    images: (B, 3, S, S), normalised, as for `unfold_batch_norm`.
    """
    if isinstance(stage.pyramid, EfficientPyramid):
        stage.pyramid.load_state_dict(net.pyramid.state_dict())
    else:
        assert isinstance(net.pyramid, Pyramid)
        unfold_batch_norm(net.pyramid, stage.pyramid, images)
    if net.config.any_shape:
        scales = cast(Tensor, net.correlation_scales).log()
        stage.log_scales[:] = scales[0]
        stage.log_scales[: len(scales)] = scales


@torch.no_grad()
def unfold_batch_norm(plain: Pyramid, trained: Pyramid, images: Tensor) -> None:
    """The inverse of `fold_batch_norm`: load a pyramid without batch norm into one with.

    Each norm gets the mean and deviation of its convolution's output over `images` (B, 3, S, S),
    normalised, both as its statistics and as its shift and scale. So it is the identity, in
    evaluation and, on images like these, in training.
    """
    convolutions = [m for m in plain.modules() if isinstance(m, nn.Conv2d)]
    modules = [m for m in trained.modules() if isinstance(m, nn.Conv2d | nn.BatchNorm2d)]
    hooks = []
    for source, target, norm in zip(convolutions, modules[::2], modules[1::2], strict=True):
        assert isinstance(norm, nn.BatchNorm2d)
        target.load_state_dict(source.state_dict())
        hooks.append(source.register_forward_hook(partial(_neutralise, norm)))
    plain(images)
    for hook in hooks:
        hook.remove()


def _neutralise(norm: nn.BatchNorm2d, module: nn.Module, inputs: object, output: Tensor) -> None:
    """Make a norm the identity on values like `output`."""
    variance, mean = torch.var_mean(output.float(), (0, 2, 3), unbiased=False)
    state = {"running_mean": mean, "running_var": variance, "bias": mean}
    state |= {"weight": (variance + norm.eps).sqrt(), "num_batches_tracked": torch.tensor(0)}
    norm.load_state_dict(state)
