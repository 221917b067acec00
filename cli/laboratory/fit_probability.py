"""`dgc-pose fit-probability`: fit the probability that a pose is right, and report on it;
`fit-folders`: fit the evidence for each pair of a folder before its triples are compared."""

from dataclasses import dataclass
from pathlib import Path
from typing import Any

import click
from tqdm import tqdm

from dgc_pose.benchmarks.probability.planned import DEFAULT_PLAN, PlanEntry, planned, read_plan
from dgc_pose.benchmarks.report import split_names
from dgc_pose.benchmarks.store import open_run, read_run
from dgc_pose.cli.guard import OutputFolder
from dgc_pose.cli.options import dataclass_options
from dgc_pose.errors import ArgumentName, InputError, require
from dgc_pose.estimation import EstimationOptions
from dgc_pose.matchers import DEVICE_HELP
from dgc_pose.network.config import DEFAULT_WEIGHTS
from dgc_pose.system.files import save_text, staged
from dgc_pose.system.options import option

_RECORDS = "records.jsonl"


@dataclass(frozen=True)
class FitChoice:
    """The data to collect and fit."""

    data: Path = option(help="Folder of the data that the plan names.")
    out: Path = option(
        help="Folder of the records and of the results.", type=OutputFolder(path_type=Path)
    )
    plan: Path | None = option(
        None,
        "JSON list of scenes and their parts, with their lists of pairs in the folder lists beside "
        "it; default: the project's own.",
        metavar="PATH",
    )
    methods: str = option(
        f"{DEFAULT_WEIGHTS},sift",
        "Comma-separated matchers: networks, of which the first is fitted, and others (sift, dis, "
        "MODEL.onnx, ...), whose matches are fitted together.",
        metavar="NAMES",
    )
    collected: bool = option(False, "Match no further pairs: fit on the records that are there.")
    device: str = option("auto", DEVICE_HELP, metavar="NAME")


@click.command()
@dataclass_options(FitChoice, "choice")
def fit_probability(choice: FitChoice) -> None:
    """Fit the probability that a pose is right: collect, fit, report.

    First matches the pairs of the plan, and records the evidence for each pose and its error in
    records.jsonl in --out; after a kill, run the same command to continue. Then fits and calibrates
    the models on some scenes, and reports on others. Writes probability.json, which the package
    reads, report.txt and reliability.png into --out. Needs the extras "fit" and "torch".
    """
    plan = choice.plan or DEFAULT_PLAN
    entries = read_plan(plan)
    require({"fit-probability": "fit"})  # before the work
    if choice.collected:
        settings, pieces = read_run(choice.out / _RECORDS)
    else:
        settings, pieces = _collected(choice, plan.parent / "lists", entries)
    from dgc_pose.benchmarks.probability.report import fit_all
    from dgc_pose.viz import save_figure

    models, report, figure = fit_all(pieces, settings, entries)
    names = "probability.json", "report.txt", "reliability.png"
    paths = [str(choice.out / name) for name in names]
    with staged(*paths) as stage:  # writes all three files or none
        model_file, report_file, figure_file = map(stage, paths)
        save_text(model_file, models)
        save_text(report_file, report + "\n")
        save_figure(figure, figure_file)
    click.echo(report)


def _collected(
    choice: FitChoice, lists: Path, entries: list[PlanEntry]
) -> tuple[dict[str, Any], list[Any]]:
    """The settings of the run, and the records of all pairs; collects the missing records."""
    from dgc_pose.benchmarks.methods import load_matchers, parse_methods
    from dgc_pose.benchmarks.probability.records import collect

    methods = parse_methods(split_names(choice.methods))
    pairs = [pair for entry in entries for pair in planned(entry, choice.data, lists)]
    loaded = load_matchers(methods, device=choice.device)
    matchers = {matcher.name: matcher for matcher in loaded}
    if len(matchers) < len(loaded):
        names = ", ".join(matcher.name for matcher in loaded)
        raise InputError(ArgumentName("methods"), f"has two matchers of one name: {names}")
    settings = {
        part: {
            name: {"name": name, "fingerprint": matcher.fingerprint}
            for name, matcher in matchers.items()
            if (matcher.engine is not None) == is_network
        }
        for part, is_network in (("engines", True), ("others", False))
    }
    with open_run(choice.out / _RECORDS, settings, resume=True) as (pieces, add):
        done = {(piece["entry"], piece["number"]) for piece in pieces}
        # One pair of each scene in turn, so that a killed collection has pairs of every scene.
        pairs.sort(key=lambda pair: pair.turn)
        for pair in tqdm(pairs, unit="pair", disable=None):
            if (pair.entry.name, pair.number) not in done:
                add(collect(pair, matchers, EstimationOptions()))
    return settings, pieces


@dataclass(frozen=True)
class FolderFitChoice:
    """The folders to match and fit."""

    data: Path = option(help="Folder with the folders photos, of textures, and posed, of scenes.")
    out: Path = option(help="Folder of images and batches.", type=OutputFolder(path_type=Path))
    folders: int = option(4, "Seeds of each kind of folder.", metavar="N", min=1, max=1000)


@click.command()
@dataclass_options(FolderFitChoice, "choice")
def fit_folders(choice: FolderFitChoice) -> None:
    """Fit the weights of `batch/look_alikes.py`: match, label, fit.

    Renders folders with repeats. Matches their pairs and the pairs of at most as many posed scenes,
    in --out; after a kill, run the same command to continue. The table also has every second and
    third photograph of a scene (/2, /3). Needs the extras "fit" and "torch".
    """
    require({"fit-folders": "fit"})  # before the work
    from dgc_pose.benchmarks.folders import collected, fit, folder_names

    names = folder_names(choice.data, choice.folders)
    bar = tqdm(names, unit="folder", disable=None)
    folders = [collected(name, choice.data, choice.out) for name in bar]
    click.echo(fit({name: pairs for parts in folders for name, pairs in parts.items()}))
