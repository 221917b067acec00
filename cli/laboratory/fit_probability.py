"""`dgc-pose fit-probability`: fit the probability that a pose is right, and report on it."""

from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path

import click
from tqdm import tqdm

from dgc_pose.benchmarks.files import split_names
from dgc_pose.benchmarks.probability.plan import DEFAULT_PLAN, PlanEntry, read_plan
from dgc_pose.cli.dataclass_options import dataclass_options
from dgc_pose.cli.guard import OutputFolder
from dgc_pose.errors import InputError, require
from dgc_pose.files.outputs import save_text, staged
from dgc_pose.matchers import DEVICE_HELP
from dgc_pose.network.config import DEFAULT_WEIGHTS
from dgc_pose.system.options import option


@dataclass(frozen=True)
class FitChoice:
    """What is collected and fitted."""

    data: Path = option(help="Folder of the data that the plan names.")
    out: Path = option(
        help="Folder of the stored matches and of the results.", type=OutputFolder(path_type=Path)
    )
    plan: Path | None = option(
        None,
        "JSON list of scenes and their parts, with their lists of pairs in the folder lists beside "
        "it; default: the project's own.",
        metavar="PATH",
    )
    methods: str = option(
        f"{DEFAULT_WEIGHTS},sift",
        "Comma-separated networks and sift; of the networks the first is fitted.",
    )
    collected: bool = option(False, "Match no further pairs: fit on those that are stored.")
    device: str = option("auto", DEVICE_HELP, metavar="NAME")


@click.command()
@dataclass_options(FitChoice, "choice")
def fit_probability(choice: FitChoice) -> None:
    """Fit the probability that a pose is right: collect, fit, report.

    Matches of the plan's pairs are stored in --out, and the same command goes on after any kill.
    Then the models are fitted and calibrated on some scenes and reported on others. Writes
    probability.json, which the package reads, report.txt and reliability.png into --out. Needs
    scikit-learn (the extra "fit").
    """
    plan = choice.plan or DEFAULT_PLAN
    entries = read_plan(plan)
    require({"fit-probability": "fit"})  # before the work
    methods = split_names(choice.methods)
    if not methods:
        raise InputError("no methods named")
    if not choice.collected:
        _collect(choice, plan.parent / "lists", methods, entries)
    from dgc_pose.benchmarks.probability.report import fit_all
    from dgc_pose.viz import save_figure

    models, report, figure = fit_all(choice.out, methods, entries)
    paths = [
        str(choice.out / name) for name in ("probability.json", "report.txt", "reliability.png")
    ]
    with staged(*paths) as stage:
        model_file, report_file, figure_file = map(stage, paths)
        save_text(model_file, models)
        save_text(report_file, report + "\n")
        save_figure(figure, figure_file)
    click.echo(report)


def _collect(
    choice: FitChoice, lists: Path, methods: Sequence[str], entries: Sequence[PlanEntry]
) -> None:
    """Match what is not stored yet."""
    from dgc_pose.benchmarks.probability.collection import collect, require_engine
    from dgc_pose.benchmarks.probability.planned import planned
    from dgc_pose.matchers import load_matcher

    matchers = {name: load_matcher(name, device=choice.device) for name in methods}
    pairs = [pair for entry in entries for pair in planned(entry, choice.data, lists)]
    for name, matcher in matchers.items():
        require_engine(choice.out, name, matcher)
    # One pair of each scene in turn: a collection that is killed has some of each.
    pairs.sort(key=lambda pair: pair.number)
    for pair in tqdm(pairs, unit="pair", disable=None):
        collect(pair, matchers, choice.out)
