"""Starting a run from trained weights instead of random ones."""

from __future__ import annotations

from functools import partial
from pathlib import Path
from typing import Any, Literal, cast

import torch
from torch import Tensor, nn

from dgc_pose.errors import WeightsError
from dgc_pose.network.efficientnet import EfficientPyramid
from dgc_pose.network.net import DGCNet
from dgc_pose.network.pyramid import Pyramid
from dgc_pose.network.weights import load_checkpoint, load_network
from dgc_pose.training.imagenet import adopt_body
from dgc_pose.training.stages import EncoderStage

InitPart = Literal["all", "encoder"]
_BODY_SHARE = 0.25  # of the learning rate: what ImageNet taught is kept longer than what is new


def rate_groups(module: nn.Module) -> list[dict[str, Any]]:
    """The parameters that learn, for an optimiser, with `share` of the learning rate for each."""
    bodies = {
        id(parameter)
        for pyramid in module.modules()
        if isinstance(pyramid, EfficientPyramid)
        for part in (pyramid.stem, pyramid.blocks)
        for parameter in part.parameters()
    }
    learning = [p for p in module.parameters() if p.requires_grad]
    groups = [
        {"params": [p for p in learning if (id(p) in bodies) == is_body], "share": share}
        for is_body, share in ((False, 1.0), (True, _BODY_SHARE))
    ]
    return [group for group in groups if group["params"]]


def adopt_imagenet(net: DGCNet, path: str | Path, images: Tensor) -> None:
    """Put EfficientNet-Lite0's own weights into a net's encoder, as `adopt_body`.

    Raises WeightsError for a file that holds others, or a net without that body.
    """
    if not isinstance(net.pyramid, EfficientPyramid):
        raise WeightsError(f"{path}: the encoder of {net.config.name} has no place for it")
    try:
        adopt_body(net.pyramid, load_checkpoint(Path(path), images.device), images)
    except (KeyError, RuntimeError, TypeError) as error:
        raise WeightsError(f"{path}: not weights of EfficientNet-Lite0 ({error})") from error


def adopt(net: DGCNet, weights: str | Path, part: InitPart = "all") -> None:
    """Put the weights of a file (or a shipped name) into a net, in place.

    Of the encoder alone, or of another preset with the same pyramid, an ablation for one, the net
    takes the pyramid and the correlation's temperatures. Raises WeightsError where the pyramids
    differ too.
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
    if net.config.soft_argmax and other.config.soft_argmax:
        levels = min(net.config.correlated_levels, other.config.correlated_levels)
        scales = cast(Tensor, net.correlation_scales)
        scales[:levels] = cast(Tensor, other.correlation_scales)[:levels]


@torch.no_grad()
def take_up(net: DGCNet, stage: EncoderStage, images: Tensor) -> None:
    """Let the encoder's stage begin with the net's pyramid and temperatures; images: normalised."""
    if isinstance(stage.pyramid, Pyramid):
        assert isinstance(net.pyramid, Pyramid)
        unfold_batch_norm(net.pyramid, stage.pyramid, images)
    else:
        stage.pyramid.load_state_dict(net.pyramid.state_dict())
    if net.config.soft_argmax:
        scales = cast(Tensor, net.correlation_scales).log()
        stage.log_scales[:] = scales[0]
        stage.log_scales[: len(scales)] = scales


@torch.no_grad()
def unfold_batch_norm(plain: Pyramid, trained: Pyramid, images: Tensor) -> None:
    """The inverse of `fold_batch_norm`: give a pyramid with batch norm the weights of one without.

    Each norm gets the mean and deviation that its convolution's output has over `images`
    (B, 3, S, S), normalised, as its statistics, and again as its shift and scale: it changes
    nothing, neither in evaluation nor, on images like these, in training.
    """
    convolutions = [m for m in plain.modules() if isinstance(m, nn.Conv2d)]
    modules = [m for m in trained.modules() if isinstance(m, nn.Conv2d | nn.BatchNorm2d)]
    hooks = []
    for source, target, norm in zip(convolutions, modules[::2], modules[1::2], strict=True):
        assert isinstance(norm, nn.BatchNorm2d)
        target.load_state_dict(source.state_dict())
        hooks.append(source.register_forward_hook(partial(_settle, norm)))
    plain(images)
    for hook in hooks:
        hook.remove()


def _settle(norm: nn.BatchNorm2d, module: nn.Module, inputs: object, output: Tensor) -> None:
    """Set a norm so that it changes nothing in values like `output`."""
    variance, mean = torch.var_mean(output.float(), (0, 2, 3), unbiased=False)
    norm.load_state_dict(
        {
            "running_mean": mean,
            "running_var": variance,
            "bias": mean,
            "weight": (variance + norm.eps).sqrt(),
            "num_batches_tracked": torch.tensor(0),
        }
    )
