"""The stage that a run is in: its module, optimiser and averaged weights."""

import math
from typing import Any, cast

import torch
from torch import Tensor, nn
from torch.optim.swa_utils import AveragedModel

from dgc_pose.network.efficientnet import EfficientPyramid
from dgc_pose.network.net import DGCNet
from dgc_pose.training.options import TrainingOptions
from dgc_pose.training.stages import DecoderStage, EncoderStage, StageName

Stage = EncoderStage | DecoderStage

_RATE, _WEIGHT_DECAY, _BETAS = 1e-3, 1e-4, (0.9, 0.98)
_WARM_UP, _LAST_RATE = 0.02, 0.02  # share of the stage; share of the highest rate
_LARGEST_GRADIENT = 3.0  # norm over all parameters
_BACKBONE_RATE = 0.35  # times the rate of the rest, to keep what ImageNet taught


class ActiveStage:
    """One stage of a run, from the network's present weights, on the device of the network."""

    def __init__(self, name: StageName, net: DGCNet, options: TrainingOptions) -> None:
        self.name = name
        self.module: Stage = EncoderStage(net) if name == "encoder" else DecoderStage(net)
        self.module.to(memory_format=torch.channels_last)  # type: ignore[call-overload]
        self.module.train()
        self.parameters = [p for p in self.module.parameters() if p.requires_grad]
        self._rate = _RATE * options.rate
        groups = _rate_groups(self.module)
        self.optimizer = torch.optim.AdamW(groups, weight_decay=_WEIGHT_DECAY, betas=_BETAS)
        self._average = moving_average(self.module, options.average_decay)

    @property
    def average(self) -> Stage:
        """The module by its averaged weights, in evaluation mode."""
        return cast(Stage, self._average.module)

    def set_rate(self, progress: float) -> float:
        """The learning rate at a progress of the stage, from 0 to 1, which the next step uses: a
        linear warm-up, then a cosine."""
        cosine = 0.5 * (1 + math.cos(math.pi * min(progress, 1.0)))
        warm = min(1.0, 0.05 + 0.95 * progress / _WARM_UP)
        rate = self._rate * warm * (_LAST_RATE + (1 - _LAST_RATE) * cosine)
        for group in self.optimizer.param_groups:
            group["lr"] = rate * group["factor"]
        return rate

    def step(self, loss: Tensor) -> Tensor:
        """One optimiser step; the gradient's norm."""
        self.optimizer.zero_grad(set_to_none=True)
        loss.backward()
        norm = torch.nn.utils.clip_grad_norm_(self.parameters, _LARGEST_GRADIENT)
        self.optimizer.step()
        self._average.update_parameters(self.module)
        return norm

    def state_dict(self) -> dict[str, Any]:
        return {
            "module": self.module.state_dict(),
            "average": self._average.state_dict(),
            "optimizer": self.optimizer.state_dict(),
        }

    def load_state_dict(self, state: dict[str, Any]) -> None:
        """Raises RuntimeError or ValueError, as torch does, for the state of another network."""
        self.module.load_state_dict(state["module"])
        self._average.load_state_dict(state["average"])
        self.optimizer.load_state_dict(state["optimizer"])


def moving_average(module: nn.Module, decay: float) -> AveragedModel:
    """The exponential moving average of a module's weights and buffers, in evaluation mode.

    The decay grows with the updates n as min(decay, n / (9 + n)), so that a run's random initial
    weights soon lose their influence. Counters are copied.
    """

    def update(averages: Any, values: Any, _: Tensor | int) -> None:
        count = int(average.n_averaged)  # on the CPU: no GPU is waited for
        if averages[0].is_floating_point():
            torch._foreach_lerp_(averages, values, 1 - min(decay, count / (9 + count)))
        else:
            torch._foreach_copy_(averages, values)

    average = AveragedModel(module, multi_avg_fn=update, use_buffers=True)
    average.n_averaged += 1  # the initial weights count
    return average.eval().requires_grad_(False)


def _rate_groups(module: nn.Module) -> list[dict[str, Any]]:
    """The trainable parameters as an optimiser's groups, each with the `factor` of its rate."""
    backbone = {
        parameter
        for pyramid in module.modules()
        if isinstance(pyramid, EfficientPyramid)
        for part in (pyramid.stem, pyramid.blocks)
        for parameter in part.parameters()
    }
    trainable = [p for p in module.parameters() if p.requires_grad]
    groups = [
        {"params": [p for p in trainable if p not in backbone], "factor": 1.0},
        {"params": [p for p in trainable if p in backbone], "factor": _BACKBONE_RATE},
    ]
    return [group for group in groups if group["params"]]
