"""`dgc-pose bench-dtu`: the paper's experiment on relative pose, over a user's copy of DTU."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path

import click

from dgc_pose.benchmarks.dtu.dataset import Dataset
from dgc_pose.benchmarks.dtu.dtu_pairs import (
    DESCRIPTIONS,
    DtuPairs,
    Protocol,
    dtu_pairs,
    protocol_options,
)
from dgc_pose.benchmarks.dtu.pair_lists import PAIRS, choose_pairs, write_pair_csv
from dgc_pose.benchmarks.dtu.report_page import write_report
from dgc_pose.benchmarks.evaluate import Evaluation
from dgc_pose.benchmarks.methods import EVERYWHERE, load_passes, parse_methods
from dgc_pose.benchmarks.posed_pairs import require_images
from dgc_pose.benchmarks.scores import DtuScore
from dgc_pose.benchmarks.summary import (
    by_method,
    heading,
    summarise_epipolar,
    summary_data,
    summary_table,
)
from dgc_pose.cli.bench_run import METHOD_FIELDS, RUN_FOLDER, RunChoice, open_store, work
from dgc_pose.cli.dataclass_options import dataclass_options
from dgc_pose.cli.dtu_pairs import FolderChoice
from dgc_pose.cli.options import split_names
from dgc_pose.errors import InputError
from dgc_pose.estimation import EstimationOptions
from dgc_pose.files.json_files import write_json
from dgc_pose.matchers import MatcherOptions
from dgc_pose.matching.files import FileMatcher
from dgc_pose.network.stored import shipped
from dgc_pose.system.options import option


def _numbers(text: str) -> tuple[int, ...]:
    names = split_names(text)
    if not names or not all(name.isdecimal() and len(name) < 10 for name in names):
        raise InputError(f"--scenes takes numbers separated by commas, not {text!r}")
    return tuple(int(name) for name in names)


@dataclass(frozen=True)
class Experiment:
    """Which pairs, in which protocol, and where the results go."""

    root: str = option(help="Folder of DTU.", metavar="DIR")
    out: str = option(
        help="Folder of the results; created if missing.", metavar="DIR", type=RUN_FOLDER
    )
    scenes: tuple[int, ...] | None = option(
        None, "Numbers of the scenes; default: all that are found.", metavar="N,N", parse=_numbers
    )
    pairs: str = option(
        str(PAIRS),
        "Number of pairs to draw over all scenes, or a list of pairs.",
        metavar="N|FILE",
    )
    protocol: Protocol = option(
        "paper", "; ".join(f"{name}: {text}" for name, text in DESCRIPTIONS.items()) + "."
    )


@click.command()
@dataclass_options(Experiment, "experiment")
@dataclass_options(FolderChoice, "folder")
@click.option(
    "--methods",
    default=lambda: ",".join(
        [*(name + end for name in shipped() for end in ("", EVERYWHERE)), "sift", "dis"]
    ),
    show_default=f"all shipped weights with and without {EVERYWHERE}, sift, dis",
    help="Comma-separated names or paths of weights, sift, dis, and names of --matches, "
    "each with options of its own, such as NAME:matchability=0.5:runs=1; "
    f"NAME{EVERYWHERE} takes all pixels that NAME maps into image 1, whatever their matchability.",
)
@click.option(
    "--matches",
    multiple=True,
    metavar="NAME=DIR",
    help="Maps, flows or matches that another program computed, as scanN_VIEW1_VIEW2 with the "
    "ending .flo, .npz, .npy or .png.",
)
@dataclass_options(RunChoice, "run")
@dataclass_options(MatcherOptions, "matcher", only=METHOD_FIELDS)
@dataclass_options(EstimationOptions, "estimation")
def bench_dtu(
    experiment: Experiment,
    folder: FolderChoice,
    methods: str,
    matches: tuple[str, ...],
    run: RunChoice,
    matcher: MatcherOptions,
    estimation: EstimationOptions,
) -> None:
    """Repeat the paper's experiment on relative camera pose over DTU.

    Each pair is written to DIR as soon as it is done: results.csv has a row for each pair and
    method, timings.csv their times. At the end summary.json, the figures and report.html are
    written. A pair without a pose counts as an infinite error. `--seed` draws the pairs and the
    samples of RANSAC; `--refine` and `--max-matches` apply to the native protocol.
    """
    stored = _folders(matches)
    protocol, out = experiment.protocol, Path(experiment.out)
    matcher, estimation = protocol_options(protocol, matcher, estimation)
    chosen = parse_methods(split_names(methods), matcher, estimation, [*stored])
    dataset = folder.open(experiment.root, experiment.scenes)
    views = choose_pairs(dataset, experiment.pairs, seed=estimation.seed, scenes=experiment.scenes)
    pairs = dtu_pairs(dataset, views, protocol)
    require_images(pairs.pairs)
    stems = pairs.stems

    def stem(name1: str, name2: str) -> str:
        return stems[name1, name2]

    for directory in stored.values():
        FileMatcher(directory, stem).require(stems)
    passes = load_passes(
        chosen,
        device=run.device,
        runtime=run.runtime,
        stored=stored,
        stem=stem,
        keep_features=True,
    )
    evaluation = Evaluation(pairs, chosen, passes, run.workers, run.pairs_together)
    for line in _opening(dataset, experiment.pairs, len(views)):
        click.echo(line)
    settings = {"protocol": protocol, "layout": dataset.layout, "light": folder.light}
    store = open_store(evaluation, experiment.out, run, settings, samples=True)
    write_pair_csv(out / "pairs.csv", views)
    work(evaluation, store)
    _print_savings(evaluation)
    data = f"DTU in the {dataset.layout} layout, light {folder.light}"
    table = _write_results(out, pairs, store.scores, _facts(data, pairs, matcher, estimation))
    click.echo(f"{protocol} protocol: {DESCRIPTIONS[protocol]}")
    click.echo(heading(estimation))
    click.echo(
        "D_e: median symmetric epipolar distance of a pair in pixels of the protocol's images, its "
        "median\nover pairs, over all pixels and over the pose's matches; pose s: estimating"
    )
    click.echo(table)
    click.echo(f"{out / 'report.html'}: the plots, and every pair with its matches")


def _print_savings(evaluation: Evaluation[DtuScore]) -> None:
    for name, caches in evaluation.passes.caches.items():
        kept = caches.features
        if kept.asked:
            click.echo(
                f"{name}: {kept.made} encoder passes instead of {kept.asked}, "
                f"{100 * (1 - kept.made / kept.asked):.0f} % saved"
            )


def _write_results(
    out: Path, pairs: DtuPairs, scores: Sequence[DtuScore], facts: Mapping[str, str]
) -> str:
    """Write summary.json, the figures and the report; returns the table."""
    summaries = [summarise_epipolar(own) for own in by_method(scores).values()]
    table = summary_table(summaries)
    data = {"protocol": pairs.protocol, "run": facts, **summary_data(summaries)}
    write_json(out / "summary.json", data)
    write_report(out, pairs, scores, facts=facts, table=table)
    return table


def _opening(dataset: Dataset, asked: str, count: int) -> list[str]:
    """What was found, and what was left out."""
    absent = sum(len(scene.missing) for scene in dataset.scenes)
    views = sum(len(scene.views) for scene in dataset.scenes)
    lines = [
        f"{dataset.layout} layout: {len(dataset.scenes)} scenes, {views} views, "
        f"{absent} left out without an image or a calibration"
    ]
    if dataset.left_out:
        names = ", ".join(f"scan{number}" for number in dataset.left_out)
        lines.append(f"left out with fewer than two views: {names}")
    short = asked.isdigit() and count < int(asked)
    lines.append(f"{count} pairs" + (f"; {asked} were asked for, there are no more" * short))
    return lines


def _facts(
    data: str, pairs: DtuPairs, matcher: MatcherOptions, estimation: EstimationOptions
) -> dict[str, str]:
    """The run, for people."""
    return {
        "protocol": f"{pairs.protocol}: {DESCRIPTIONS[pairs.protocol]}",
        "data": data,
        "scenes": ", ".join(map(str, sorted({scene for scene, _, _ in pairs.keys}))),
        "pairs": str(len(pairs.keys)),
        "estimator": heading(estimation).splitlines()[0].removeprefix("estimator "),
        "matchability": f"{matcher.matching.matchability:g} at least",
        "seed": str(estimation.seed),
    }


def _folders(matches: Sequence[str]) -> dict[str, Path]:
    """NAME=DIR, by name."""
    folders: dict[str, Path] = {}
    for text in matches:
        name, equals, folder = text.partition("=")
        if not name or not equals or not folder:
            raise InputError(f"--matches takes NAME=DIR, not {text!r}")
        if name.endswith(EVERYWHERE) or set(name) & set(",:"):
            raise InputError(
                f"--matches: a name holds no comma, no colon and no {EVERYWHERE}, as {name!r}"
            )
        if name in folders:
            raise InputError(f"--matches: {name} is given twice")
        folders[name] = Path(folder)
    return folders
