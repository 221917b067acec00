"""Several processes that train one network, one a GPU, as torchrun starts them.

A process that trains alone may call everything here.
"""

import os
from collections.abc import Iterator
from contextlib import contextmanager
from typing import Any

import torch
import torch.distributed as dist
from torch import Tensor, nn

from dgc_pose.errors import InputError


@contextmanager
def process_group(device: torch.device) -> Iterator[torch.device]:
    """Join the other processes if torchrun started several; yields this process's device.

    For "cuda", each process of a host gets a GPU of its own. Raises InputError if the host has
    fewer.
    """
    if int(os.environ.get("WORLD_SIZE", "1")) == 1:
        yield device
        return
    if device.type == "cuda":
        index = int(os.environ.get("LOCAL_RANK", "0"))
        if index >= torch.cuda.device_count():
            raise InputError(f"{torch.cuda.device_count()} GPUs are too few for every process")
        device = torch.device("cuda", index)
        torch.cuda.set_device(device)
    dist.init_process_group("cpu:gloo,cuda:nccl" if device.type == "cuda" else "gloo")
    try:
        yield device
    finally:
        dist.destroy_process_group()


def process_count() -> int:
    return dist.get_world_size() if dist.is_available() and dist.is_initialized() else 1


def rank() -> int:
    """0 in the process that logs, validates and saves."""
    return dist.get_rank() if process_count() > 1 else 0


def joint_sum(value: Tensor) -> Tensor:
    """The sum of a tensor over all processes, without a gradient."""
    if process_count() == 1:
        return value
    total = value.detach().clone()
    dist.all_reduce(total)
    return total


def from_first(value: float) -> float:
    """The first process's value, in all of them. Sent between the CPUs: no GPU waits for it."""
    if process_count() == 1:
        return value
    sent = torch.tensor([value], dtype=torch.float64)
    dist.broadcast(sent, 0)
    return float(sent)


class _JointSum(torch.autograd.Function):
    """The sum over all processes, with a gradient: the sum of the gradients of all processes."""

    @staticmethod
    def forward(ctx: Any, value: Tensor) -> Tensor:
        return joint_sum(value)

    @staticmethod
    def backward(ctx: Any, *gradients: Tensor) -> Tensor:
        return joint_sum(gradients[0].contiguous())


class JointBatchNorm2d(nn.BatchNorm2d):
    """Batch norm by the statistics of the batches of all processes, on any device.

    torch's SyncBatchNorm does the same on GPUs alone. Every process must have as many values.
    """

    def forward(self, values: Tensor) -> Tensor:
        count = process_count()
        if not self.training or count == 1:
            return super().forward(values)
        wide = values.to(torch.promote_types(values.dtype, torch.float32))
        part_variance, part_mean = torch.var_mean(wide, (0, 2, 3), unbiased=False)
        part = torch.stack([part_mean, part_variance + part_mean.square()])
        mean, square = (_JointSum.apply(part) / count).unbind()
        variance = (square - mean.square()).clamp(min=0)
        assert self.running_mean is not None and self.running_var is not None
        assert self.momentum is not None and self.num_batches_tracked is not None
        total = count * values.numel() // len(mean)
        self.num_batches_tracked.add_(1)
        self.running_mean.lerp_(mean.detach(), self.momentum)
        # By the unbiased variance, as torch does.
        self.running_var.lerp_(variance.detach() * (total / (total - 1)), self.momentum)
        scale = self.weight * torch.rsqrt(variance + self.eps)
        shift = self.bias - mean * scale
        return (values * scale[:, None, None] + shift[:, None, None]).to(values.dtype)


def join_batch_norms(module: nn.Module) -> None:
    """Replace every batch norm inside `module` by a joint one with the same parameters."""
    for name, child in module.named_children():
        if type(child) is nn.BatchNorm2d:
            joint = JointBatchNorm2d(child.num_features, child.eps)
            joint.weight, joint.bias = child.weight, child.bias
            for key, buffer in child.named_buffers():
                joint.register_buffer(key, buffer)
            joint.train(child.training)
            setattr(module, name, joint)
        else:
            join_batch_norms(child)
