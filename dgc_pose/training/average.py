"""The exponential moving average of a module's weights, which a run validates and writes."""

from __future__ import annotations

from copy import deepcopy
from typing import Any, Generic, TypeVar

import torch
from torch import nn

Module = TypeVar("Module", bound=nn.Module)


class MovingAverage(Generic[Module]):
    """A copy of a module, in evaluation mode, whose weights and buffers follow it at `update`.

    The decay grows with the updates n as min(decay, (1 + n) / (10 + n)), so that a run's random
    initial weights soon lose their influence. Counters are copied. Unlike torch's AveragedModel it
    counts on the processor: an update waits for no GPU.
    """

    def __init__(self, module: Module, decay: float) -> None:
        self.module = deepcopy(module).eval().requires_grad_(False)
        self.decay = decay
        self.updates = 0

    @torch.no_grad()
    def update(self, module: Module) -> None:
        weight = 1 - min(self.decay, (1 + self.updates) / (10 + self.updates))
        self.updates += 1
        own, new = self.module.state_dict(), module.state_dict()
        moving = [key for key, value in own.items() if value.is_floating_point()]
        torch._foreach_lerp_([own[key] for key in moving], [new[key] for key in moving], weight)
        for key in own.keys() - set(moving):
            own[key].copy_(new[key])

    def state_dict(self) -> dict[str, Any]:
        return {"module": self.module.state_dict(), "updates": self.updates}

    def load_state_dict(self, state: dict[str, Any]) -> None:
        self.module.load_state_dict(state["module"])
        self.updates = state["updates"]
