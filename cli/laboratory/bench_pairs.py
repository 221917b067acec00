"""`dgc-pose bench-pairs`: score methods on pairs with known poses."""

import hashlib
import json
from collections.abc import Sequence
from dataclasses import asdict, dataclass
from pathlib import Path
from typing import Literal

import click
from tqdm import tqdm

from dgc_pose.benchmarks.dtu.histograms import plot_errors
from dgc_pose.benchmarks.dtu.protocol import PAPER_SIZE, paper_options
from dgc_pose.benchmarks.evaluate import score
from dgc_pose.benchmarks.methods import EVERYWHERE, CameraTrial, load_matchers, parse_methods
from dgc_pose.benchmarks.other_matchers import pair_files
from dgc_pose.benchmarks.posed_pairs import ListedPairs
from dgc_pose.benchmarks.report import (
    CAMERA_COLUMNS,
    CAMERA_HEADING,
    columns,
    finite_data,
    heading,
    split_names,
    summarise,
    summary_table,
    write_rows,
)
from dgc_pose.benchmarks.store import open_run
from dgc_pose.cameras.pair_list import Pair, read_pairs
from dgc_pose.cli.guard import NamedPath, OutputFolder
from dgc_pose.cli.options import dataclass_options
from dgc_pose.errors import InputError
from dgc_pose.estimation import EstimationOptions
from dgc_pose.matchers import DEVICE_HELP, RUNTIME_HELP, MatcherOptions, RuntimeName, device_type
from dgc_pose.network.config import DEFAULT_WEIGHTS
from dgc_pose.system.files import replaced
from dgc_pose.system.options import option
from dgc_pose.system.texts import write_json
from dgc_pose.viz import save_figure

FILES = ("run.jsonl", "results.csv", "summary.json", "errors.png")  # written by a run
Protocol = Literal["native", "paper"]
PROTOCOL_HELP = (
    "paper: images squared to 256x256, every match, the best of --runs RANSAC runs (the paper's: 5 "
    "of 1000 iterations), not refined; native: images as stored, an even subsample of the matches, "
    "matches and poses refined."
)


@dataclass(frozen=True)
class PairBenchOptions:
    """The pairs, the methods scored on them, the protocol, and the files to write."""

    root: str | None = option(
        None, "Folder of the image paths; by default the list's own.", type=NamedPath()
    )
    limit: int | None = option(None, "Only the first N pairs.", metavar="N", min=1, max=10**9)
    protocol: Protocol = option("native", PROTOCOL_HELP)
    methods: str = option(
        f"{DEFAULT_WEIGHTS},sift",
        "Comma-separated names or paths of weights or other matchers (sift, dis); "
        f"NAME{EVERYWHERE} takes all pixels that NAME maps into image 1, whatever their "
        "matchability.",
    )
    matches: tuple[str, ...] = option(
        (),
        "Maps, flows or matches that another program computed, a file a pair: the names of both "
        "images with - for /, joined by _, and the ending .flo, .npz or .npy. A method of that "
        "name.",
        metavar="NAME=DIR",
    )
    out: Path | None = option(
        None,
        "Write run.jsonl (each pair as soon as it is done), and results.csv, summary.json and "
        "errors.png there.",
        metavar="DIR",
        type=OutputFolder(*FILES, path_type=Path),
    )
    resume: bool = option(False, "Continue the run in --out, if there is one.")
    device: str = option("auto", DEVICE_HELP, metavar="NAME")
    runtime: RuntimeName = option("auto", RUNTIME_HELP, metavar="NAME", section="matching")


@click.command()
@click.argument("pair_list", metavar="LIST", type=click.Path())
@dataclass_options(PairBenchOptions, "options")
@dataclass_options(CameraTrial, "cameras")
@dataclass_options(MatcherOptions, "matcher", only=("matching",))
@dataclass_options(EstimationOptions, "estimation")
def bench_pairs(
    pair_list: str,
    options: PairBenchOptions,
    cameras: CameraTrial,
    matcher: MatcherOptions,
    estimation: EstimationOptions,
) -> None:
    """Score methods on the pairs of LIST, in SuperGlue's format.

    Prints for each method the median errors, AUC@5/10/20 of the larger of rotation and folded
    translation error, the number of failures, seconds per pair (matching and estimation), and D_e,
    the distances of matches from the true epipolar lines. A pair without a pose counts as an
    infinite error.

    --K and --K-scale withhold or change the K of LIST for all methods. Errors always refer to the
    true cameras. A second table has the warnings of the poses and the errors of focal lengths.
    """
    if options.out is None and options.resume:
        raise InputError("--resume needs the --out of the run to continue")
    listed = read_pairs(pair_list, options.root)[: options.limit]
    run_bench(listed, options, cameras, matcher, estimation)


def run_bench(
    listed: Sequence[Pair],
    options: PairBenchOptions,
    cameras: CameraTrial,
    matcher: MatcherOptions,
    estimation: EstimationOptions,
) -> None:
    """Score methods on pairs; print the tables and write the files of `bench-pairs`."""
    out = options.out
    paper = options.protocol == "paper"
    if paper:
        matcher, estimation = paper_options(matcher, estimation)
    folders = _folders(options.matches)
    names = split_names(options.methods)
    methods = parse_methods(names, matcher, estimation, [*folders], cameras)
    pairs = ListedPairs(listed, size=PAPER_SIZE if paper else None)
    stored = {name: pair_files(path, listed) for name, path in folders.items()}
    matchers = load_matchers(methods, device=options.device, runtime=options.runtime, stored=stored)
    all_names = [(pair.name1, pair.name2) for pair in listed]
    settings = {
        "pairs": hashlib.sha256(json.dumps(all_names).encode()).hexdigest()[:16],
        "methods": [asdict(method) for method in methods],
        "weights": {
            method.matcher.weights: matcher.fingerprint
            for method, matcher in zip(methods, matchers, strict=True)
            if matcher.fingerprint is not None
        },
        "device": device_type(options.device),
        "protocol": options.protocol,
    }
    with open_run(out and out / FILES[0], settings, resume=options.resume) as (done, add):
        if done:
            click.echo(f"{len(done)} of {len(listed)} pairs are done already")
        numbers = range(len(done), len(listed))
        for k in tqdm(numbers, total=len(listed), initial=len(done), unit="pair", disable=None):
            each = zip(methods, matchers, strict=True)
            pair = pairs.pair(k)
            add([score(all_names[k], pair, *method) for method in each])
    scores = [row for pair_rows in done for row in pair_rows]
    figures = columns(scores)
    summaries = [summarise(method, column) for method, column in figures.items()]
    if out is not None:
        with replaced(out / "results.csv") as file:
            write_rows(file, scores)
        write_json(out / "summary.json", {"methods": finite_data(summaries)})
        with replaced(out / "errors.png") as file:
            save_figure(plot_errors(figures), file)
    click.echo(f"{heading(estimation)}\n{summary_table(summaries)}")
    if any(method.cameras.reports for method in methods):
        click.echo(f"\n{CAMERA_HEADING}\n{summary_table(summaries, CAMERA_COLUMNS)}")


def _folders(matches: Sequence[str]) -> dict[str, Path]:
    """The folders of options NAME=DIR, by name."""
    folders: dict[str, Path] = {}
    for text in matches:
        name, _, folder = text.partition("=")
        if not name or not folder or name in folders or set(name) & set(",:/"):
            raise InputError(
                f"--matches takes NAME=DIR, each name once and without comma, colon and slash, "
                f"not {text!r}"
            )
        folders[name] = Path(folder)
    return folders
