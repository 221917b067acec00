"""The common part of the pose benchmarks: their options, the run, and what it writes."""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from importlib import import_module
from pathlib import Path
from typing import Any

import click
from tqdm import tqdm

from dgc_pose.benchmarks.evaluate import evaluate, settings
from dgc_pose.benchmarks.files import finite_data
from dgc_pose.benchmarks.methods import EVERYWHERE, Method, load_matchers
from dgc_pose.benchmarks.posed_pairs import ListedPairs
from dgc_pose.benchmarks.store import RESULTS, SETTINGS, RunStore
from dgc_pose.benchmarks.stored_matches import FileMatcher
from dgc_pose.benchmarks.summary import Summary, columns, summarise
from dgc_pose.cli.guard import OutputFolder, overwrites
from dgc_pose.errors import InputError
from dgc_pose.files.json_files import write_json
from dgc_pose.files.outputs import replaced
from dgc_pose.network.config import DEFAULT_WEIGHTS
from dgc_pose.runtime.load import DEVICE_HELP, RUNTIME_HELP, RuntimeName, device_type
from dgc_pose.system.options import option

_SUMMARY, _ERRORS, PAIRS = "summary.json", "errors.png", "pairs.txt"
RUN_FOLDER = OutputFolder(SETTINGS, RESULTS, _SUMMARY, _ERRORS, PAIRS, path_type=Path)


@dataclass(frozen=True)
class RunChoice:
    """What is scored, and how."""

    methods: str = option(
        f"{DEFAULT_WEIGHTS},sift",
        "Comma-separated names or paths of weights or other matchers (sift, dis), each with "
        "options of its own, such as NAME:refine=none:runs=1; "
        f"NAME{EVERYWHERE} takes all pixels that NAME maps into image 1, whatever their "
        "matchability.",
    )
    resume: bool = option(False, "Continue the run in --out, if there is one.")
    device: str = option("auto", DEVICE_HELP, metavar="NAME")
    runtime: RuntimeName = option("auto", RUNTIME_HELP, metavar="NAME", section="matching")


def run_bench(
    pairs: ListedPairs,
    methods: Sequence[Method],
    out: Path | None,
    run: RunChoice,
    *,
    stored: Mapping[str, FileMatcher] | None = None,
    data: Mapping[str, Any] | None = None,
) -> list[Summary]:
    """Work through the pairs that `out` does not hold yet, and write the summary and the figure.

    stored: matchers of stored matches by name. data: what the records depend on besides.
    """
    if out is None and run.resume:
        raise InputError("--resume needs the --out of the run to continue")
    if out is not None:
        import_module("dgc_pose.viz")  # it may be missing, which is better known before the work
    matchers = load_matchers(methods, device=run.device, runtime=run.runtime, stored=stored)
    known = settings(pairs, methods, matchers, device_type(run.device))
    known |= data or {}
    store = RunStore(out, len(methods), known, resume=run.resume, overwrite=overwrites())
    total = len(pairs.ids)
    if store.done:
        click.echo(f"{store.done} of {total} pairs are done already")
    rows = evaluate(pairs, methods, matchers, store.done)
    with store:
        for scores in tqdm(rows, total=total, initial=store.done, unit="pair", disable=None):
            store.add(scores)
    figures = columns(store.scores)
    summaries = [summarise(method, column) for method, column in figures.items()]
    if out is not None:
        from dgc_pose.benchmarks.curves import plot_errors
        from dgc_pose.viz import save_figure

        write_json(out / _SUMMARY, {"methods": finite_data(summaries)})
        with replaced(out / _ERRORS) as file:
            save_figure(plot_errors(figures), file)
    return summaries
