"""`dgc-pose bench-dtu`: the paper's experiment on relative pose, over a user's copy of DTU."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import get_args

import click

from dgc_pose.benchmarks.dtu.dataset import Dataset, Layout, open_dataset
from dgc_pose.benchmarks.dtu.dtu_pairs import (
    DESCRIPTIONS,
    DtuPairs,
    Protocol,
    dtu_pairs,
    protocol_options,
)
from dgc_pose.benchmarks.dtu.pair_lists import PAIRS, choose_pairs, write_pair_csv
from dgc_pose.benchmarks.dtu.report_page import write_report
from dgc_pose.benchmarks.dtu.scene import LIGHTS
from dgc_pose.benchmarks.evaluate import Evaluation
from dgc_pose.benchmarks.methods import EVERYWHERE, MethodOptions, load_engines, parse_methods
from dgc_pose.benchmarks.posed_pairs import require_images
from dgc_pose.benchmarks.scores import DtuScore
from dgc_pose.benchmarks.store import RunStore
from dgc_pose.benchmarks.summary import (
    by_method,
    heading,
    map_table,
    summarise_maps,
    summary_data,
)
from dgc_pose.cli.bench_run import RunChoice, open_store, run_options, work
from dgc_pose.cli.options import (
    device_option,
    estimator_options,
    matchability_option,
    refine_option,
    refinement_options,
    split_names,
)
from dgc_pose.cli.output import json_text
from dgc_pose.errors import InputError
from dgc_pose.estimation import EstimationOptions
from dgc_pose.files import write_text
from dgc_pose.matchers import SIFT
from dgc_pose.matching import MatchingOptions
from dgc_pose.matching.files import FileMatcher
from dgc_pose.matching.flow import FLOWS
from dgc_pose.network.weights import shipped
from dgc_pose.refinement import SourceName


@dataclass(frozen=True)
class _Plan:
    """What is to be run."""

    evaluation: Evaluation[DtuScore]
    pairs: DtuPairs
    defaults: MethodOptions
    facts: Mapping[str, str]  # for people


@click.command()
@click.option("--root", required=True, metavar="DIR", help="The folder of DTU.")
@click.option("--out", required=True, metavar="DIR", help="Folder of the run; made if need be.")
@click.option(
    "--layout",
    type=click.Choice(get_args(Layout)),
    help="Of the files in that folder; by default found by looking.",
)
@click.option("--scenes", metavar="N,N", help="Numbers of the scenes; by default all found.")
@click.option(
    "--pairs",
    default=str(PAIRS),
    show_default=True,
    metavar="N|FILE",
    help="How many pairs to draw over all scenes, or a list of them.",
)
@click.option(
    "--protocol",
    type=click.Choice(get_args(Protocol)),
    default="paper",
    show_default=True,
    help="; ".join(f"{name}: {text}" for name, text in DESCRIPTIONS.items()) + ".",
)
@click.option(
    "--methods",
    default=lambda: ",".join(
        [*(name + end for name in shipped() for end in ("", EVERYWHERE)), SIFT, *FLOWS]
    ),
    show_default=f"all shipped weights with and without {EVERYWHERE}, {SIFT}, {', '.join(FLOWS)}",
    help="Names or paths of weights, sift, dis, farneback, and names of --matches, with commas "
    "between, each with options of its own if need be, as NAME:matchability=0.5:runs=1; "
    f"NAME{EVERYWHERE} takes all pixels that NAME maps into image 1, whatever their matchability.",
)
@click.option(
    "--matches",
    multiple=True,
    metavar="NAME=DIR",
    help="Maps, flows or matches that another program computed, as scanN_VIEW1_VIEW2 with the "
    "ending .flo, .npz, .npy or .png.",
)
@click.option(
    "--light", type=click.Choice(LIGHTS), default="3", show_default=True, help="Which light."
)
@matchability_option
@run_options
@device_option
@refine_option
@estimator_options
def bench_dtu(
    root: str,
    out: str,
    layout: Layout | None,
    scenes: str | None,
    pairs: str,
    protocol: Protocol,
    methods: str,
    matches: tuple[str, ...],
    light: str,
    matchability: float,
    run: RunChoice,
    device: str,
    refine: SourceName | None,
    estimation: EstimationOptions,
) -> None:
    """Repeat the paper's experiment on relative camera pose over DTU.

    Each pair goes to DIR as soon as it is done: results.csv has a row for each pair and method,
    timings.csv their times. At the end come summary.json, the figures and report.html. A pair
    without a pose counts as an infinite error. `--seed` draws the pairs, and the poses' samples;
    `--refine` is of the native protocol.
    """
    numbers = None if scenes is None else _numbers(scenes)
    stored = _folders(matches)
    matching = MatchingOptions(matchability=matchability)
    refinement = refinement_options(refine, matching)
    defaults = protocol_options(protocol, MethodOptions(matching, refinement, estimation))
    chosen = parse_methods(split_names(methods), defaults, [*stored])
    dataset = open_dataset(root, layout=layout, scenes=numbers, light=light)
    views = choose_pairs(dataset, pairs, seed=estimation.seed, scenes=numbers)
    posed = dtu_pairs(dataset, views, protocol)
    require_images(posed.pairs)
    stems = posed.stems
    for folder in stored.values():
        FileMatcher(folder, lambda *names: stems[names]).require(stems)
    engines = load_engines(
        chosen,
        device=device,
        stored=stored,
        stem=lambda *names: stems[names],
        keep_features=True,
    )
    facts = _facts(dataset, posed, defaults, light)
    plan = _Plan(Evaluation(posed, chosen, engines, run.options(device)), posed, defaults, facts)
    for line in _opening(dataset, pairs, len(views)):
        click.echo(line)
    settings = {"protocol": protocol, "layout": dataset.layout, "light": light}
    store = open_store(
        plan.evaluation, out, device, settings, resume=run.resume, samples=True
    )
    write_pair_csv(Path(out, "pairs.csv"), views)
    work(plan.evaluation, store)
    _finish(plan, store, Path(out))


def _finish(plan: _Plan, store: RunStore[DtuScore], out: Path) -> None:
    """The savings, summary.json, figures and report, and the table."""
    for name, caches in plan.evaluation.engines.caches.items():
        kept = caches.features
        if kept.asked:
            click.echo(
                f"{name}: {kept.made} encoder passes instead of {kept.asked}, "
                f"{100 * (1 - kept.made / kept.asked):.0f} % saved"
            )
    protocol = plan.pairs.protocol
    summaries = [summarise_maps(own) for own in by_method(store.scores).values()]
    table = map_table(summaries)
    data = {"protocol": protocol, "run": plan.facts, **summary_data(summaries)}
    write_text(out / "summary.json", json_text(data))
    write_report(out, plan.pairs, store.scores, facts=plan.facts, table=table)
    click.echo(f"{protocol} protocol: {DESCRIPTIONS[protocol]}")
    click.echo(heading(plan.defaults.estimation))
    click.echo(
        "D_e: median symmetric epipolar distance of a pair in pixels of the protocol's images, its "
        "median\nover pairs, over all pixels and over the pose's matches; pose s: estimating"
    )
    click.echo(table)
    click.echo(f"{out / 'report.html'}: the plots, and every pair with its matches")


def _opening(dataset: Dataset, asked: str, count: int) -> list[str]:
    """What was found, and what was not."""
    absent = sum(scene.absent for scene in dataset.scenes)
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
    dataset: Dataset, pairs: DtuPairs, defaults: MethodOptions, light: str
) -> dict[str, str]:
    estimation = defaults.estimation
    scenes = sorted({scene for scene, _, _ in pairs.keys})
    return {
        "protocol": f"{pairs.protocol}: {DESCRIPTIONS[pairs.protocol]}",
        "data": f"DTU in the {dataset.layout} layout, light {light}",
        "scenes": ", ".join(map(str, scenes)),
        "pairs": str(len(pairs.keys)),
        "estimator": heading(estimation).splitlines()[0].removeprefix("estimator "),
        "matchability": f"{defaults.matching.matchability:g} at least",
        "seed": str(estimation.seed),
    }


def _numbers(scenes: str) -> list[int]:
    names = split_names(scenes)
    if not names or not all(name.isdecimal() for name in names):
        raise InputError(f"--scenes takes numbers with commas between, not {scenes!r}")
    return [int(name) for name in names]


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
