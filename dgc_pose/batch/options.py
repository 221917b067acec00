"""The options of a batch, apart from those of its matcher and estimator."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Literal

from dgc_pose.system.options import check_options, option
from dgc_pose.system.parallel import usable_cpus

_GIB = 2**30
_WORKER_GIB = 0.375


@dataclass(frozen=True)
class BatchOptions:
    """How a batch is run; no option changes the result."""

    workers: int | None = option(
        None, "Processes; default: one for each core.", metavar="N", min=1, max=1024
    )
    memory: float | None = option(
        None,
        "GiB kept by all workers; default: 0.375 for each.",
        metavar="GIB",
        above=0,
        max=10**6,
        section="advanced",
    )
    engine: Literal["local", "ray"] = option(
        "local",
        "local: this machine; ray: actors of a Ray cluster (extra ray).",
        metavar="NAME",
        section="advanced",
    )
    resume: bool = option(False, "Continue the batch that is there, if there is one.")

    def __post_init__(self) -> None:
        check_options(self)

    @property
    def worker_count(self) -> int:
        """The number of workers; by default one for each core."""
        return self.workers or usable_cpus()

    @property
    def worker_bytes(self) -> int:
        """Memory for images and features of one worker, bytes."""
        memory = _WORKER_GIB * self.worker_count if self.memory is None else self.memory
        return int(memory * _GIB) // self.worker_count
