"""Starting a run from trained weights instead of random ones."""

from __future__ import annotations

from functools import partial
from pathlib import Path
from typing import Literal, cast

import torch
from torch import Tensor, nn

from dgc_pose.errors import WeightsError
from dgc_pose.network.net import DGCNet
from dgc_pose.network.pyramid import Pyramid
from dgc_pose.network.weights import load_network
from dgc_pose.training.stages import EncoderStage

InitPart = Literal["all", "encoder"]


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
    unfold_batch_norm(net.pyramid, stage.pyramid, images)
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
