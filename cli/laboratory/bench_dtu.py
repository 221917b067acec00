"""`dgc-pose bench-dtu`: the paper's experiment on relative pose, over a user's copy of DTU."""

from dataclasses import replace
from pathlib import Path
from typing import get_args

import click

from dgc_pose.benchmarks.camera_trial import CameraTrial
from dgc_pose.benchmarks.dtu.view_pairs import ViewPairOptions
from dgc_pose.cameras.pair_list import write_pairs
from dgc_pose.cli.guard import OutputFolder
from dgc_pose.cli.laboratory.bench_pairs import (
    FILES,
    PROTOCOL_HELP,
    PairBenchOptions,
    Protocol,
    run_bench,
)
from dgc_pose.cli.laboratory.dtu_pairs import DtuChoice, drawn_pairs
from dgc_pose.cli.options import dataclass_options
from dgc_pose.estimation import EstimationOptions
from dgc_pose.matchers import MatcherOptions
from dgc_pose.system.files import replaced

_LIST = "pairs.txt"


@click.command()
@click.argument("root", metavar="ROOT")
@click.option(
    "--out",
    required=True,
    type=OutputFolder(_LIST, *FILES, path_type=Path),
    metavar="DIR",
    help="Folder of the results: pairs.txt, results.csv, summary.json and errors.png.",
)
@click.option(
    "--protocol", type=click.Choice(get_args(Protocol)), default="paper", help=PROTOCOL_HELP
)
@dataclass_options(DtuChoice, "choice")
@dataclass_options(
    ViewPairOptions, "views", only=("pairs", "min_rotation", "max_rotation", "min_overlap")
)
@dataclass_options(
    PairBenchOptions, "options", only=("methods", "matches", "resume", "device", "runtime")
)
@dataclass_options(MatcherOptions, "matcher", only=("matching",))
@dataclass_options(EstimationOptions, "estimation")
def bench_dtu(
    root: str,
    out: Path,
    protocol: Protocol,
    choice: DtuChoice,
    views: ViewPairOptions,
    options: PairBenchOptions,
    matcher: MatcherOptions,
    estimation: EstimationOptions,
) -> None:
    """Repeat the paper's experiment on relative camera pose over DTU.

    ROOT holds DTU as its authors ship it. It is `dtu-pairs`, with the seed of the estimation, and
    `bench-pairs` over its list, which is pairs.txt in DIR.
    """
    path, views = out / _LIST, replace(views, seed=estimation.seed)
    drawn = drawn_pairs(root, choice, views, path)
    options = replace(options, out=out, protocol=protocol)
    run_bench(drawn, options, CameraTrial(), matcher, estimation)
    with replaced(path) as stage:  # last: the list of a run that is not gone on with stays
        write_pairs(stage, drawn)
