"""The stage that a run is in: its module, optimiser and averaged weights."""

import math
from typing import Any, cast

import torch
from torch import Tensor, nn
from torch.optim.swa_utils import AveragedModel

from dgc_pose.network.net import DGCNet
from dgc_pose.training.stages import DecoderStage, EncoderStage, StageName

_RATE, _WEIGHT_DECAY, _BETAS = 1e-3, 1e-4, (0.9, 0.98)
_WARM_UP, _LAST_RATE = 0.02, 0.02  # share of the stage; share of the highest rate
_LARGEST_GRADIENT = 3.0  # norm over all parameters
_DECAY = 0.999  # at most, of the exponential moving average of the weights
# The layers that ImageNet taught learn more slowly.
_BACKBONE, _BACKBONE_RATE = ("net.pyramid.stem.", "net.pyramid.blocks."), 0.35


class ActiveStage:
    """One stage of a run, from the network's present weights, on the device of the network.

    rate: factor of the learning rates.
    """

    def __init__(self, name: StageName, net: DGCNet, rate: float) -> None:
        self.name = name
        self.module = EncoderStage(net) if name == "encoder" else DecoderStage(net)
        self.module.to(memory_format=torch.channels_last)  # type: ignore[call-overload]
        self.module.train()
        named = self.module.named_parameters()
        trained = {key: parameter for key, parameter in named if parameter.requires_grad}
        self.parameters = list(trained.values())
        backbone = [parameter for key, parameter in trained.items() if key.startswith(_BACKBONE)]
        rest = [parameter for key, parameter in trained.items() if not key.startswith(_BACKBONE)]
        groups = [{"params": rest, "share": 1.0}, {"params": backbone, "share": _BACKBONE_RATE}]
        self._rate = _RATE * rate
        self.optimizer = torch.optim.AdamW(groups, weight_decay=_WEIGHT_DECAY, betas=_BETAS)
        self._average = moving_average(self.module, _DECAY)

    @property
    def average(self) -> EncoderStage | DecoderStage:
        """The module by its averaged weights, in evaluation mode."""
        return cast(EncoderStage | DecoderStage, self._average.module)

    def set_rate(self, progress: float) -> float:
        """The learning rate at a progress of the stage, from 0 to 1, which the next step uses: a
        linear warm-up, then a cosine."""
        cosine = 0.5 * (1 + math.cos(math.pi * min(progress, 1.0)))
        warm = min(1.0, 0.05 + 0.95 * progress / _WARM_UP)
        rate = self._rate * warm * (_LAST_RATE + (1 - _LAST_RATE) * cosine)
        for group in self.optimizer.param_groups:
            group["lr"] = rate * group["share"]
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
