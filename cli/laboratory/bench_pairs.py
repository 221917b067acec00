"""`dgc-pose bench-pairs`: methods scored on pairs with known poses."""

from dataclasses import dataclass
from pathlib import Path

import click

from dgc_pose.benchmarks.camera_trial import CameraTrial
from dgc_pose.benchmarks.files import split_names
from dgc_pose.benchmarks.methods import parse_methods
from dgc_pose.benchmarks.posed_pairs import ListedPairs, require_images
from dgc_pose.benchmarks.summary import CAMERA_COLUMNS, CAMERA_HEADING, heading, summary_table
from dgc_pose.cameras.pair_list import read_pairs
from dgc_pose.cli.dataclass_options import NamedPath, dataclass_options
from dgc_pose.cli.laboratory.bench_run import RUN_FOLDER, RunChoice, run_bench
from dgc_pose.estimation import EstimationOptions
from dgc_pose.matchers import MatcherOptions
from dgc_pose.system.options import option


@dataclass(frozen=True)
class PairBenchOptions:
    """Which pairs, and where the results go."""

    root: str | None = option(
        None, "Folder of the image paths; by default the list's own.", type=NamedPath()
    )
    limit: int | None = option(None, "Only the first N pairs.", metavar="N", min=1, max=10**9)
    every: int = option(
        1, "Only the first of every N pairs of LIST.", metavar="N", min=1, max=10**9
    )
    out: Path | None = option(
        None,
        "Write results.csv (each pair as soon as it is done), summary.json and errors.png there.",
        metavar="DIR",
        type=RUN_FOLDER,
    )


@click.command()
@click.argument("pair_list", metavar="LIST", type=click.Path())
@dataclass_options(PairBenchOptions, "options")
@dataclass_options(CameraTrial, "cameras")
@dataclass_options(RunChoice, "run")
@dataclass_options(MatcherOptions, "matcher", only=("matching",))
@dataclass_options(EstimationOptions, "estimation")
def bench_pairs(
    pair_list: str,
    options: PairBenchOptions,
    cameras: CameraTrial,
    run: RunChoice,
    matcher: MatcherOptions,
    estimation: EstimationOptions,
) -> None:
    """Score methods on the pairs of LIST, in SuperGlue's format.

    Prints for each method the median errors, AUC@5/10/20 of the larger of rotation and folded
    translation error, the number of failures, seconds a pair (matching and estimating), and D_e,
    the distances of the matches from the true epipolar lines. A pair without a pose counts as an
    infinite error.

    With --K and its like the K of LIST are withheld or changed, for all methods or, by NAME:K=auto,
    NAME:K=auto:shared or NAME:K_scale=0.8, for one of several. Errors are of the true cameras as
    before; a second table has the focal lengths and what the poses state.
    """
    methods = parse_methods(split_names(run.methods), matcher, estimation, cameras=cameras)
    pairs = read_pairs(pair_list, options.root)[:: options.every][: options.limit]
    require_images(pairs)
    summaries = run_bench(ListedPairs(pairs), methods, options.out, run)
    click.echo(f"{heading(estimation)}\n{summary_table(summaries)}")
    if any(method.cameras.reports for method in methods):
        click.echo(f"\n{CAMERA_HEADING}\n{summary_table(summaries, CAMERA_COLUMNS)}")
