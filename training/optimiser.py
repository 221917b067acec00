"""How a stage learns: groups of parameters, the rate, and averaged weights."""

import math

import torch
from torch import nn

_RATE, _WEIGHT_DECAY, _BETAS = 1e-3, 1e-4, (0.9, 0.98)
_WARM_UP, _LAST_RATE = 0.02, 0.02  # share of the stage; share of the highest rate
_DECAY = 0.999  # at most, of the exponential moving average of the weights
# The layers that ImageNet taught learn more slowly.
_BACKBONE, _BACKBONE_RATE = ("net.pyramid.stem.", "net.pyramid.blocks."), 0.35


def optimiser(stage: nn.Module) -> torch.optim.AdamW:
    """Of a stage's trainable parameters, in groups with their `share` of the rate."""
    trained = [(key, value) for key, value in stage.named_parameters() if value.requires_grad]
    rest = [value for key, value in trained if not key.startswith(_BACKBONE)]
    backbone = [value for key, value in trained if key.startswith(_BACKBONE)]
    groups = [{"params": rest, "share": 1.0}, {"params": backbone, "share": _BACKBONE_RATE}]
    return torch.optim.AdamW(groups, weight_decay=_WEIGHT_DECAY, betas=_BETAS)


def rate_at(progress: float) -> float:
    """The learning rate at a progress of the stage, from 0 to 1: a linear warm-up, then a
    cosine."""
    cosine = 0.5 * (1 + math.cos(math.pi * min(progress, 1.0)))
    warm = min(1.0, 0.05 + 0.95 * progress / _WARM_UP)
    return _RATE * warm * (_LAST_RATE + (1 - _LAST_RATE) * cosine)


@torch.no_grad()
def move_average(average: nn.Module, module: nn.Module, steps: int, decay: float = _DECAY) -> None:
    """Move an exponential moving average of a module's weights and buffers on, after `steps` steps.

    The decay grows as min(decay, steps / (9 + steps)), so that a run's random initial weights soon
    lose their influence. Counters are copied.
    """
    share = 1 - min(decay, steps / (9 + steps))
    values = module.state_dict().values()
    for mean, value in zip(average.state_dict().values(), values, strict=True):
        if mean.is_floating_point():
            mean.lerp_(value, share)
        else:
            mean.copy_(value)
