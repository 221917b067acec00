"""A few steps of each stage, alone or under torchrun: what the losses and the weights come to."""

import sys
from pathlib import Path

import torch
from photos import drawn_photos
from torch import nn

from dgc_pose.training.options import TrainingOptions
from dgc_pose.training.processes import (
    join_batch_norms,
    joint_sum,
    process_count,
    process_group,
    rank,
)
from dgc_pose.training.run import Trainer
from dgc_pose.training.schedule import STAGES, Schedule
from dgc_pose.training.synthesis.batches import joined
from dgc_pose.training.synthesis.draw import seeded
from dgc_pose.training.synthesis.map_pairs import MapPairs
from dgc_pose.training.synthesis.options import PairOptions
from dgc_pose.training.synthesis.random_pairs import make_pairs

_SCHEDULE = Schedule(0.3, 0.7, 0.0)
PROGRESS = {"encoder": 0.2, "decoders": 0.6}  # of the schedule


class _BothParts(Trainer):
    """Trains on the joint batch of two processes, each part of it made as its process makes it."""

    def _make_pairs(self) -> MapPairs:
        size = STAGES[self._stage.name].size
        draws = [seeded(self.options.seed, self.step, "pairs", part) for part in (0, 1)]
        options = self.options.pairs
        return joined([make_pairs(self.photos, 1, size, draw, options) for draw in draws])


def joint_run(out: Path) -> dict[str, dict[str, object]]:
    """Of each stage, from the same random weights: figures of two steps, gradients of the first.

    A batch is two pairs. A process that runs alone makes both, as two processes would: see
    `_BothParts`.
    """
    photos = drawn_photos(4, 64)
    pairs = PairOptions(scene_share=0.0)
    options = TrainingOptions(
        minutes=1.0, schedule=_SCHEDULE, pairs=pairs, validation_count=1, batch=2
    )
    kind = Trainer if process_count() > 1 else _BothParts
    results: dict[str, dict[str, object]] = {}
    for stage, progress in PROGRESS.items():
        trainer = kind((photos, photos), out / stage, options)
        first = _figures(trainer, progress)
        gradients = [p.grad.clone() for p in trainer.parameters if p.grad is not None]
        second = _figures(trainer, progress)
        net = trainer.averaged().state_dict()
        results[stage] = {"first": first, "second": second, "gradients": gradients, "net": net}
    return results


def joint_norm() -> dict[str, torch.Tensor]:
    """A batch norm's output for this process's half of a batch, and all that follows of it."""
    generator = torch.Generator().manual_seed(3)
    images = 3 * torch.rand(4, 2, 5, 5, generator=generator, dtype=torch.float64) + 1
    weights = torch.rand(4, 2, 5, 5, generator=generator, dtype=torch.float64)
    own = images.chunk(process_count())[rank()].requires_grad_()
    layers = nn.Sequential(nn.BatchNorm2d(2).double())
    join_batch_norms(layers)
    output = layers(own)
    (output.square() * weights.chunk(process_count())[rank()]).sum().backward()
    gradients = {key: joint_sum(value.grad) for key, value in layers.named_parameters()}
    buffers = dict(layers.named_buffers())
    return {"output": output.detach(), "input": own.grad, **gradients, **buffers}


def _figures(trainer: Trainer, progress: float) -> dict[str, float]:
    figures = trainer.train_step(progress)
    figures.pop("gradient")  # compared as it is
    return {name: float(joint_sum(part)) for name, part in figures.items()}


if __name__ == "__main__":
    torch.set_num_threads(1)
    folder = Path(sys.argv[1])
    with process_group(torch.device("cpu")):
        torch.save(joint_norm(), folder / f"norm{rank()}.pt")
        result = joint_run(folder / "run")
        if rank() == 0:
            torch.save(result, folder / "result.pt")
