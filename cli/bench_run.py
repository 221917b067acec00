"""What the pose benchmarks share: --workers, --batch and --resume, and the run."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import click
from tqdm import tqdm

from dgc_pose.benchmarks.evaluate import Evaluation
from dgc_pose.benchmarks.scores import RESULTS, Score
from dgc_pose.benchmarks.store import SETTINGS, RunStore, keys_of
from dgc_pose.cli.guard import OutputFolder, overwrites
from dgc_pose.errors import InputError
from dgc_pose.matchers import RUNTIME_HELP, DeviceName
from dgc_pose.runtime.load import RuntimeName, device_type
from dgc_pose.system.options import check_options, option

GPU_BATCH = 16
RUN_FOLDER = OutputFolder(SETTINGS, RESULTS, "summary.json", "errors.png", "report.html")


# The options of all methods that a specification leaves open.
METHOD_FIELDS = ("matching", "refinement")  # of `MatcherOptions`


@dataclass(frozen=True)
class RunChoice:
    """How a data set is worked through."""

    workers: int = option(
        1,
        "Processes that estimate poses; the results are the same for any number.",
        min=1,
        max=1024,
    )
    batch: int | None = option(
        None,
        f"Pairs that a network matches together; default: {GPU_BATCH} on a GPU, 1 on a CPU.",
        min=1,
        max=4096,
    )
    resume: bool = option(False, "Continue the run in --out, if there is one.")
    device: DeviceName = option("auto", "Where the network runs.")
    runtime: RuntimeName = option("auto", RUNTIME_HELP)

    def __post_init__(self) -> None:
        check_options(self)

    @property
    def device_type(self) -> str:
        """ "cpu" or "cuda". Raises InputError if there is no such device."""
        return device_type(self.device)

    @property
    def pairs_together(self) -> int:
        """--batch, by default that of the device."""
        return self.batch or (GPU_BATCH if self.device_type == "cuda" else 1)


def open_store(
    evaluation: Evaluation[Score],
    out: str | None,
    run: RunChoice,
    settings: Mapping[str, Any] | None = None,
    *,
    samples: bool = False,
) -> RunStore[Score]:
    """The store of an evaluation; its records depend on `settings` besides."""
    if out is None and run.resume:
        raise InputError("--resume needs the --out of the run to continue")
    return RunStore(
        None if out is None else Path(out),
        evaluation.pairs.kind,
        keys_of(evaluation.pairs, [method.name for method in evaluation.methods]),
        {**(settings or {}), **evaluation.settings(run.device_type)},
        resume=run.resume,
        overwrite=overwrites(),
        samples=samples,
    )


def work(evaluation: Evaluation[Score], store: RunStore[Score]) -> None:
    """Work through the pairs that are not done yet, with a progress bar on a terminal."""
    first, total = store.done, len(evaluation.pairs.ids)
    if first:
        click.echo(f"{first} of {total} pairs are done already")
    rows = evaluation.run(first)
    with store:
        for scored in tqdm(rows, total=total, initial=first, unit="pair", disable=None):
            store.add(scored)
