"""`dgc-pose bench-dtu`: the paper's experiment on relative pose, over a user's copy of DTU."""

from __future__ import annotations

import hashlib
from collections.abc import Mapping, Sequence
from dataclasses import asdict, dataclass
from pathlib import Path
from typing import Any, get_args

import click
from tqdm import tqdm

from dgc_pose.benchmarks.dtu.dataset import Dataset, Layout, open_dataset
from dgc_pose.benchmarks.dtu.entries import PAIRS, Entry, choose_pairs, make_entries
from dgc_pose.benchmarks.dtu.methods import (
    EVERYWHERE,
    Engines,
    Method,
    external_matcher,
    load_engines,
    pair_stems,
    parse_methods,
)
from dgc_pose.benchmarks.dtu.pair_files import write_pair_csv
from dgc_pose.benchmarks.dtu.protocols import DESCRIPTIONS, matching_options
from dgc_pose.benchmarks.dtu.records import Protocol
from dgc_pose.benchmarks.dtu.report_page import write_report
from dgc_pose.benchmarks.dtu.run import RunOptions, run
from dgc_pose.benchmarks.dtu.scene import LIGHTS
from dgc_pose.benchmarks.dtu.store import RunStore
from dgc_pose.benchmarks.dtu.summary import dtu_table, summarise_methods
from dgc_pose.benchmarks.methods import SIFT
from dgc_pose.benchmarks.pairs import require_images
from dgc_pose.benchmarks.report import heading, summary_data
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
from dgc_pose.files import staged
from dgc_pose.matching import MatchingOptions
from dgc_pose.matching.flow import FLOWS
from dgc_pose.network.device import choose_device
from dgc_pose.network.weights import shipped
from dgc_pose.refinement import SourceName

_GPU_BATCH = 16


@dataclass(frozen=True)
class _Plan:
    """What is to be run."""

    dataset: Dataset
    entries: Sequence[Entry]
    methods: Sequence[Method]
    engines: Engines
    options: RunOptions
    settings: Mapping[str, Any]  # all that the results depend on
    facts: Mapping[str, str]  # the same for people


@click.command()
@click.option("--root", required=True, metavar="DIR", help="Where DTU lies.")
@click.option("--out", required=True, metavar="DIR", help="Folder of the run; made if need be.")
@click.option(
    "--layout",
    type=click.Choice(get_args(Layout)),
    help="How the data set lies there; found by looking, by default.",
)
@click.option("--scenes", metavar="N,N", help="Numbers of the scenes; all that are there.")
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
    f"between; NAME{EVERYWHERE} takes all pixels that NAME places, whatever their matchability.",
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
    show_default=f"{_GPU_BATCH} on a GPU, 1 on a CPU",
    help="Pairs that a network matches together.",
)
@click.option("--resume", is_flag=True, help="Go on with the run that DIR holds, if it holds one.")
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
    workers: int,
    batch: int | None,
    resume: bool,
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
    external = _folders(matches)
    found = parse_methods(split_names(methods), [*external])
    dataset = open_dataset(root, layout=layout, scenes=numbers, light=light)
    chosen = choose_pairs(dataset, pairs, seed=estimation.seed, scenes=numbers)
    entries = make_entries(dataset, chosen)
    require_images([entry.pair for entry in entries])
    stems = pair_stems(entries)
    for folder in external.values():
        external_matcher(folder, stems).require(stems)
    options = RunOptions(
        protocol,
        MatchingOptions(matchability=matchability),
        estimation,
        workers,
        batch or (_GPU_BATCH if choose_device(device).type == "cuda" else 1),
    )
    refinement = refinement_options(refine, options.matching) if protocol == "native" else None
    engines = load_engines(
        found,
        external,
        stems,
        device=device,
        options=matching_options(protocol, options.matching),
        refinement=refinement,
    )
    facts = _facts(dataset, entries, options, light)
    settings = {
        **_settings(dataset, entries, found, engines, options, light, device),
        "refinement": refinement and asdict(refinement),
    }
    plan = _Plan(dataset, entries, found, engines, options, settings, facts)
    for line in _opening(dataset, pairs, len(entries)):
        click.echo(line)
    with _open_store(Path(out), plan, resume) as store:
        write_pair_csv(store.out / "pairs.csv", chosen)
        _work(plan, store)
    _finish(plan, store)


def _open_store(out: Path, plan: _Plan, resume: bool) -> RunStore:
    keys = [
        [(method.name, entry.scene, entry.view1, entry.view2) for method in plan.methods]
        for entry in plan.entries
    ]
    return RunStore(out, plan.settings, keys, resume=resume)


def _work(plan: _Plan, store: RunStore) -> None:
    """Do the pairs that are not done, with the time left on a terminal."""
    first, total = store.done, len(plan.entries)
    if first:
        click.echo(f"{first} of {total} pairs are done already")
    rows = run(plan.entries, plan.methods, plan.engines, plan.options, first)
    for scored in tqdm(rows, total=total, initial=first, unit="pair", disable=None):
        store.add(scored)
    for name, cache in plan.engines.caches.items():
        if cache.asked:
            click.echo(
                f"{name}: {cache.made} encoder passes instead of {cache.asked}, "
                f"{100 * (1 - cache.made / cache.asked):.0f} % saved"
            )


def _finish(plan: _Plan, store: RunStore) -> None:
    """summary.json, figures and report, and the table."""
    summaries = summarise_methods(store.results, store.timings)
    table = dtu_table(summaries)
    data = {"protocol": plan.options.protocol, "run": plan.facts, **summary_data(summaries)}
    path = str(store.out / "summary.json")
    with staged(path) as stage:
        stage(path).write_text(json_text(data), encoding="utf-8")
    write_report(
        store.out, plan.entries, store.results, store.timings, facts=plan.facts, table=table
    )
    protocol = plan.options.protocol
    click.echo(f"{protocol} protocol: {DESCRIPTIONS[protocol]}")
    click.echo(heading(plan.options.estimation))
    click.echo(
        "D_e: median symmetric epipolar distance of a pair in pixels of the protocol's images, its "
        "median\nover pairs, over all pixels and over the pose's matches; pose s: estimating"
    )
    click.echo(table)
    click.echo(f"{store.out / 'report.html'}: the plots, and every pair with its matches")


def _opening(dataset: Dataset, asked: str, count: int) -> list[str]:
    """What was found, and what was not."""
    absent = sum(scene.absent for scene in dataset.scenes)
    views = sum(len(scene.views) for scene in dataset.scenes)
    lines = [
        f"{dataset.layout} layout: {len(dataset.scenes)} scenes, {views} views, "
        f"{absent} left out for want of an image or a calibration"
    ]
    if dataset.left_out:
        names = ", ".join(f"scan{number}" for number in dataset.left_out)
        lines.append(f"left out for want of two views: {names}")
    short = asked.isdigit() and count < int(asked)
    lines.append(f"{count} pairs" + (f"; {asked} were asked for, there are no more" * short))
    return lines


def _facts(
    dataset: Dataset, entries: Sequence[Entry], options: RunOptions, light: str
) -> dict[str, str]:
    estimation = options.estimation
    scenes = sorted({entry.scene for entry in entries})
    return {
        "protocol": f"{options.protocol}: {DESCRIPTIONS[options.protocol]}",
        "data": f"DTU in the {dataset.layout} layout, light {light}",
        "scenes": ", ".join(map(str, scenes)),
        "pairs": str(len(entries)),
        "estimator": heading(estimation).splitlines()[0].removeprefix("estimator "),
        "matchability": f"{options.matching.matchability:g} at least",
        "seed": str(estimation.seed),
    }


def _settings(
    dataset: Dataset,
    entries: Sequence[Entry],
    methods: Sequence[Method],
    engines: Engines,
    options: RunOptions,
    light: str,
    device: str,
) -> dict[str, Any]:
    """All that the rows depend on; the number of workers is not among it."""
    ids = "\n".join(f"{one.scene} {one.view1} {one.view2}" for one in entries)
    return {
        "protocol": options.protocol,
        "layout": dataset.layout,
        "light": light,
        "pairs": hashlib.sha256(ids.encode()).hexdigest()[:16],
        "methods": [method.name for method in methods],
        "weights": dict(engines.fingerprints),
        "matching": asdict(options.matching),
        "estimation": asdict(options.estimation),
        "batch": options.batch,
        "device": choose_device(device).type,
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
        if name.endswith(EVERYWHERE) or "," in name:
            raise InputError(f"--matches: a name holds no comma and no {EVERYWHERE}, as {name!r}")
        if name in folders:
            raise InputError(f"--matches: {name} stands twice")
        folders[name] = Path(folder)
    return folders
