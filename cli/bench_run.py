"""What the pose benchmarks share: --workers, --batch and --resume, and the run itself."""

from __future__ import annotations

import functools
from collections.abc import Callable, Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import click
from tqdm import tqdm

from dgc_pose.benchmarks.evaluate import Evaluation, RunOptions
from dgc_pose.benchmarks.scores import Score
from dgc_pose.benchmarks.store import RunStore, keys_of
from dgc_pose.errors import InputError
from dgc_pose.network.device import choose_device

Command = Callable[..., Any]
GPU_BATCH = 16


@dataclass(frozen=True)
class RunChoice:
    """How the user wants a run worked through."""

    workers: int
    batch: int | None
    resume: bool

    def options(self, device: str) -> RunOptions:
        """Without --batch it is that of the device."""
        gpu = choose_device(device).type == "cuda"
        return RunOptions(self.workers, self.batch or (GPU_BATCH if gpu else 1))


def run_options(command: Command) -> Command:
    """--workers, --batch and --resume, as `run: RunChoice`."""

    @click.option(
        "--workers",
        type=click.IntRange(min=1),
        default=1,
        show_default=True,
        help="Processes that estimate poses; the results are the same for any number.",
    )
    @click.option(
        "--batch",
        type=click.IntRange(min=1),
        show_default=f"{GPU_BATCH} on a GPU, 1 on a CPU",
        help="Pairs that a network matches together.",
    )
    @click.option(
        "--resume", is_flag=True, help="Go on with the run that --out holds, if it holds one."
    )
    @functools.wraps(command)
    def wrapper(*args: Any, workers: int, batch: int | None, resume: bool, **kwargs: Any) -> Any:
        return command(*args, run=RunChoice(workers, batch, resume), **kwargs)

    return wrapper


def open_store(
    evaluation: Evaluation[Score],
    out: str | None,
    device: str,
    settings: Mapping[str, Any],
    *,
    resume: bool,
    samples: bool = False,
) -> RunStore[Score]:
    """The store of an evaluation, whose records depend on `settings` besides."""
    if out is None and resume:
        raise InputError("--resume needs the --out of the run to go on with")
    return RunStore(
        None if out is None else Path(out),
        evaluation.pairs.kind,
        keys_of(evaluation.pairs, [method.name for method in evaluation.methods]),
        {**settings, **evaluation.settings(choose_device(device).type)},
        resume=resume,
        samples=samples,
    )


def work(evaluation: Evaluation[Score], store: RunStore[Score]) -> None:
    """Do the pairs that are not done, with the time left on a terminal."""
    first, total = store.done, len(evaluation.pairs.ids)
    if first:
        click.echo(f"{first} of {total} pairs are done already")
    rows = evaluation.run(first)
    with store:
        for scored in tqdm(rows, total=total, initial=first, unit="pair", disable=None):
            store.add(scored)
