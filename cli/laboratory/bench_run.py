"""The common part of the pose benchmarks: --workers and --resume, and the run."""

from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import click
from tqdm import tqdm

from dgc_pose.benchmarks.evaluate import Evaluation
from dgc_pose.benchmarks.scores import RESULTS, Score
from dgc_pose.benchmarks.store import SETTINGS, RunStore
from dgc_pose.cli.guard import OutputFolder, overwrites
from dgc_pose.errors import InputError
from dgc_pose.runtime.load import DEVICE_HELP, RUNTIME_HELP, RuntimeName, device_type
from dgc_pose.system.options import option

RUN_FOLDER = OutputFolder(SETTINGS, RESULTS, "summary.json", "errors.png", "report.html")
# The options of all methods that a specification leaves open.
METHOD_FIELDS = ("matching", "refinement")  # of `MatcherOptions`


@dataclass(frozen=True)
class RunChoice:
    """How a data set is worked through."""

    workers: int = option(
        1, "Processes that estimate poses; their number changes no result.", min=1, max=1024
    )
    resume: bool = option(False, "Continue the run in --out, if there is one.")
    device: str = option("auto", DEVICE_HELP, metavar="NAME")
    runtime: RuntimeName = option("auto", RUNTIME_HELP, metavar="NAME", section="matching")


def work(
    evaluation: Evaluation[Score],
    out: str | None,
    run: RunChoice,
    settings: Mapping[str, Any] | None = None,
) -> list[Score]:
    """Work through the pairs that `out` does not hold yet, with a progress bar on a terminal.

    settings: what the records depend on besides. Returns all records.
    """
    if out is None and run.resume:
        raise InputError("--resume needs the --out of the run to continue")
    store = RunStore(
        None if out is None else Path(out),
        evaluation.pairs.kind,
        len(evaluation.methods),
        {**(settings or {}), **evaluation.settings(device_type(run.device))},
        resume=run.resume,
        overwrite=overwrites(),
    )
    first, total = store.done, len(evaluation.pairs.ids)
    if first:
        click.echo(f"{first} of {total} pairs are done already")
    rows = evaluation.run(first)
    with store:
        for scores in tqdm(rows, total=total, initial=first, unit="pair", disable=None):
            store.add(scores)
    return store.scores
