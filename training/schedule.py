"""The stages of a run, their shares of its length, and their learning rates."""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import Literal

from dgc_pose.errors import InputError

StageName = Literal["encoder", "decoders", "polish"]
_WARM_UP = 0.02  # of a stage


@dataclass(frozen=True)
class StageOptions:
    """One stage's batches and rates."""

    batch: int = 8  # pairs a step on a CPU
    gpu_batch: int = 64  # pairs a step on a GPU
    size: int = 240  # pixels a side of the views
    learning_rate: float = 1e-3  # at its highest
    weight_decay: float = 1e-4


STAGES: dict[StageName, StageOptions] = {
    "encoder": StageOptions(batch=16, gpu_batch=128, size=160, learning_rate=2e-3),
    "decoders": StageOptions(),
    "polish": StageOptions(learning_rate=1e-4),
}


@dataclass(frozen=True)
class Schedule:
    """Each stage's share of a run's length: a run of M minutes is a complete schedule."""

    encoder: float = 0.45
    decoders: float = 0.45
    polish: float = 0.10

    def __post_init__(self) -> None:
        shares = tuple(getattr(self, name) for name in STAGES)
        if not (min(shares) >= 0 and abs(sum(shares) - 1) <= 1e-6):
            raise InputError(f"the stages' shares must be positive and sum to 1, not {shares}")

    @classmethod
    def parse(cls, text: str) -> Schedule:
        """From percentages, as "45,45,10". Raises InputError for any other text."""
        try:
            shares = [float(part) / 100 for part in text.split(",")]
        except ValueError:
            shares = []
        if len(shares) != len(STAGES):
            raise InputError(
                f"split must be three percentages, 45,45,10 ({', '.join(STAGES)}), not {text}"
            )
        return cls(*shares)

    def without_encoder(self) -> Schedule:
        """The same, the encoder's share divided among the others in proportion."""
        trained = self.decoders + self.polish
        return Schedule(0.0, self.decoders / trained, self.polish / trained)

    def at(self, progress: float) -> tuple[StageName, float]:
        """The stage at a run's progress (0 to 1) and the progress within that stage."""
        start = 0.0
        stages = [(name, float(getattr(self, name))) for name in STAGES]
        for name, share in stages:
            if share > 0 and progress < start + share:
                return name, (progress - start) / share
            start += share
        last = [name for name, share in stages if share > 0][-1]
        return last, 1.0


def learning_rate(options: StageOptions, progress: float) -> float:
    """Linear warm-up, then a cosine to a hundredth of the highest rate."""
    if progress < _WARM_UP:
        return options.learning_rate * (0.05 + 0.95 * progress / _WARM_UP)
    cosine = 0.5 * (1 + math.cos(math.pi * min(progress, 1.0)))
    return options.learning_rate * (0.01 + 0.99 * cosine)
