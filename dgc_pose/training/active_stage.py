"""The stage that a run is in: its module, optimiser and averaged weights."""

from __future__ import annotations

from copy import deepcopy
from typing import Any

import torch
from torch import Tensor, nn
from torch.nn.parallel import DistributedDataParallel

from dgc_pose.network.efficientnet import EfficientPyramid
from dgc_pose.network.net import DGCNet
from dgc_pose.training.average import MovingAverage
from dgc_pose.training.initialise import initialise_stage
from dgc_pose.training.options import RunOptions
from dgc_pose.training.processes import join_batch_norms, process_count
from dgc_pose.training.schedule import STAGES, StageName, learning_rate
from dgc_pose.training.stages import CoarsestStage, DecoderStage, EncoderStage

_LARGEST_GRADIENT = 5.0  # norm over all parameters
_BACKBONE_RATE = 0.25  # times the rate of the rest, to keep what ImageNet taught


class ActiveStage:
    """One stage of a run, from the network's present weights, on the device of the network.

    images: (B, 3, S, S), normalised, that batch norm is initialised with if the run starts from
    trained weights. A pretrained backbone learns at a quarter of the rate.
    """

    def __init__(self, name: StageName, net: DGCNet, options: RunOptions, images: Tensor) -> None:
        self.name = name
        self._net = net
        self.module = _module(name, net, options, images)
        self.module.to(memory_format=torch.channels_last)  # type: ignore[call-overload]
        self.module.train()
        self.parameters = [p for p in self.module.parameters() if p.requires_grad]
        self.shared: nn.Module = self.module  # synchronises gradients between processes
        if process_count() > 1:
            join_batch_norms(self.module)
            self.shared = DistributedDataParallel(self.module)
        self._settings = STAGES[name]
        self._rate = options.rate
        self.optimizer = torch.optim.AdamW(
            _rate_groups(self.module),
            lr=self._settings.learning_rate,
            weight_decay=self._settings.weight_decay,
        )
        self.average = MovingAverage(self.module, options.average_decay)

    def set_rate(self, progress: float) -> float:
        """The learning rate at a progress of the stage, from 0 to 1; the next step uses it."""
        rate = self._rate * learning_rate(self._settings, progress)
        for group in self.optimizer.param_groups:
            group["lr"] = rate * group.get("factor", 1.0)
        return rate

    def step(self, loss: Tensor) -> Tensor:
        """One optimiser step by this process's part of the joint loss; the gradient's norm."""
        self.optimizer.zero_grad(set_to_none=True)
        # Gradients are averaged over the processes, and the loss is the sum of their parts.
        (loss * process_count()).backward()
        norm = torch.nn.utils.clip_grad_norm_(self.parameters, _LARGEST_GRADIENT)
        self.optimizer.step()
        self.average.update(self.module)
        return norm

    def averaged(self) -> DGCNet:
        """A copy of the network by the averaged weights."""
        module = self.average.module
        if isinstance(module, CoarsestStage):
            return deepcopy(module.net)
        net = deepcopy(self._net)
        module.write(net)
        return net

    def state_dict(self) -> dict[str, Any]:
        return {
            "module": self.module.state_dict(),
            "average": self.average.state_dict(),
            "optimizer": self.optimizer.state_dict(),
        }

    def load_state_dict(self, state: dict[str, Any]) -> None:
        """Raises RuntimeError or ValueError, as torch does, for the state of another network."""
        self.module.load_state_dict(state["module"])
        self.average.load_state_dict(state["average"])
        self.optimizer.load_state_dict(state["optimizer"])


def _module(
    name: StageName, net: DGCNet, options: RunOptions, images: Tensor
) -> EncoderStage | CoarsestStage:
    if name == "encoder":
        stage = EncoderStage(net).to(images.device)
        if options.init is not None:
            initialise_stage(stage, net, images)
        return stage
    if name == "coarsest":
        return CoarsestStage(net, options.unfreeze or "coarsest")
    return DecoderStage(net, end_to_end=name == "polish", unfrozen=options.unfreeze)


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
