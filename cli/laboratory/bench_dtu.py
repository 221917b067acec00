"""`dgc-pose bench-dtu`: the paper's experiment on relative pose, over a user's copy of DTU."""

from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from pathlib import Path

import click

from dgc_pose.benchmarks.dtu.dataset import Dataset
from dgc_pose.benchmarks.dtu.dtu_pairs import DESCRIPTIONS, DtuPairs, Protocol, protocol_options
from dgc_pose.benchmarks.dtu.pair_lists import PAIRS, choose_pairs, write_pair_csv
from dgc_pose.benchmarks.dtu.report_page import write_report
from dgc_pose.benchmarks.dtu.view_pairs import listed_pair
from dgc_pose.benchmarks.evaluate import Evaluation
from dgc_pose.benchmarks.files import split_names
from dgc_pose.benchmarks.methods import EVERYWHERE, load_matchers, parse_methods
from dgc_pose.benchmarks.posed_pairs import require_images
from dgc_pose.benchmarks.stored_matches import FileMatcher, pair_files
from dgc_pose.benchmarks.summary import (
    by_method,
    heading,
    summarise,
    summary_data,
    summary_table,
)
from dgc_pose.cli.dataclass_options import dataclass_options
from dgc_pose.cli.laboratory.bench_run import METHOD_FIELDS, RUN_FOLDER, RunChoice, work
from dgc_pose.cli.laboratory.dtu_pairs import FolderChoice
from dgc_pose.errors import InputError
from dgc_pose.estimation import EstimationOptions
from dgc_pose.files.json_files import write_json
from dgc_pose.matchers import MatcherOptions
from dgc_pose.network.config import DEFAULT_WEIGHTS
from dgc_pose.system.options import option


def _numbers(text: str) -> tuple[int, ...]:
    try:
        return tuple(int(name) for name in split_names(text))
    except ValueError:
        raise InputError(f"--scenes takes numbers separated by commas, not {text!r}") from None


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
        str(PAIRS), "Number of pairs to draw over all scenes, or a list of pairs.", metavar="N|FILE"
    )
    protocol: Protocol = option(
        "paper", "; ".join(f"{name}: {text}" for name, text in DESCRIPTIONS.items()) + "."
    )


@click.command()
@dataclass_options(Experiment, "experiment")
@dataclass_options(FolderChoice, "folder")
@click.option(
    "--methods",
    default=",".join([DEFAULT_WEIGHTS, DEFAULT_WEIGHTS + EVERYWHERE, "sift", "dis"]),
    show_default=True,
    help="Comma-separated names or paths of weights, of other matchers (sift, dis, "
    "deepmatching) and of --matches, each with options of its own, such as "
    "NAME:matchability=0.5:runs=1; "
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
    protocol, out = experiment.protocol, Path(experiment.out)
    matcher, estimation = protocol_options(protocol, matcher, estimation)
    stored = _folders(matches)
    chosen = parse_methods(split_names(methods), matcher, estimation, [*stored])
    dataset = folder.open(experiment.root, experiment.scenes)
    views = choose_pairs(dataset, experiment.pairs, seed=estimation.seed, scenes=experiment.scenes)
    pairs = DtuPairs(views, [listed_pair(dataset, view) for view in views], protocol)
    require_images(pairs.pairs)
    files = {
        name: FileMatcher(name, pair_files(path, pairs.stems)) for name, path in stored.items()
    }
    matchers = load_matchers(
        chosen, device=run.device, runtime=run.runtime, stored=files, keep_features=True
    )
    click.echo("\n".join(_opening(dataset, experiment.pairs, len(views))))
    settings = {"protocol": protocol, "layout": dataset.layout, "light": folder.light}
    scores = work(Evaluation(pairs, chosen, matchers, run.workers), experiment.out, run, settings)
    write_pair_csv(out / "pairs.csv", views)
    summaries = [summarise(rows) for rows in by_method(scores).values()]
    facts = {
        "protocol": f"{protocol}: {DESCRIPTIONS[protocol]}",
        "data": f"DTU in the {dataset.layout} layout, light {folder.light}",
        "scenes": ", ".join(map(str, sorted({view.scene for view in views}))),
        "pairs": str(len(views)),
        "estimator": heading(estimation).splitlines()[0].removeprefix("estimator "),
        "matchability": f"{matcher.matching.matchability:g} at least",
        "seed": str(estimation.seed),
    }
    data = {"protocol": protocol, "run": facts, **summary_data(summaries)}
    write_json(out / "summary.json", data)
    table = summary_table(summaries)
    write_report(out, scores, facts=facts, table=table)
    click.echo(
        f"{protocol} protocol: {DESCRIPTIONS[protocol]}\n{heading(estimation)}\n"
        "D_e: median symmetric epipolar distance of a pair in pixels of the protocol's images, its "
        "median\nover pairs, over all pixels and over the pose's matches; pose s: estimating\n"
        f"{table}\n{out / 'report.html'}: the plots and the pairs"
    )


def _opening(dataset: Dataset, asked: str, count: int) -> Iterator[str]:
    """What was found, and what was left out."""
    views = sum(len(scene.views) for scene in dataset.scenes)
    missing = sum(scene.missing for scene in dataset.scenes)
    yield (
        f"{dataset.layout} layout: {len(dataset.scenes)} scenes, {views} views, "
        f"{missing} left out without an image or a calibration"
    )
    if dataset.left_out:
        names = ", ".join(f"scan{number}" for number in dataset.left_out)
        yield f"left out with fewer than two views: {names}"
    short = asked.isdigit() and count < int(asked)
    yield f"{count} pairs" + f"; {asked} were asked for, there are no more" * short


def _folders(matches: Sequence[str]) -> dict[str, Path]:
    """NAME=DIR, by name."""
    folders: dict[str, Path] = {}
    for text in matches:
        name, _, folder = text.partition("=")
        if not name or not folder or name.endswith(EVERYWHERE) or set(name) & set(",:"):
            raise InputError(
                f"--matches takes NAME=DIR, the name without comma, colon and {EVERYWHERE}, "
                f"not {text!r}"
            )
        if name in folders:
            raise InputError(f"--matches: {name} is given twice")
        folders[name] = Path(folder)
    return folders
