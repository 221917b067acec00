"""`dgc-pose bench-dtu`: the paper's experiment on relative pose, on a user's copy of DTU."""

from dataclasses import dataclass, replace
from pathlib import Path

import click

from dgc_pose.benchmarks.dtu.pairs import Light, dtu_pairs
from dgc_pose.benchmarks.methods import CameraTrial
from dgc_pose.cameras.pair_list import write_pairs
from dgc_pose.cli.guard import OutputFolder
from dgc_pose.cli.laboratory.bench_pairs import (
    FILES,
    PROTOCOL_HELP,
    PairBenchOptions,
    Protocol,
    run_bench,
)
from dgc_pose.cli.options import dataclass_options
from dgc_pose.estimation import EstimationOptions
from dgc_pose.matchers import MatcherOptions
from dgc_pose.system.files import replaced
from dgc_pose.system.options import option

_LIST = "pairs.txt"


@dataclass(frozen=True)
class DtuChoice:
    """The pairs of DTU, and the protocol."""

    scan: int | None = option(None, "Number of the scan; default: all that are there.")
    light: Light = option("3", "Number of the light, or max.")
    pairs: int = option(64, "Pairs of all scans together.", metavar="N", min=1, max=10**7)
    protocol: Protocol = option("paper", PROTOCOL_HELP)


@click.command()
@click.argument("root", metavar="ROOT", type=click.Path(path_type=Path))
@click.option(
    "--out",
    required=True,
    type=OutputFolder(_LIST, *FILES, path_type=Path),
    metavar="DIR",
    help="Folder of the results: pairs.txt and the files of bench-pairs.",
)
@dataclass_options(DtuChoice, "choice")
@dataclass_options(
    PairBenchOptions, "options", only=("methods", "matches", "resume", "device", "runtime")
)
@dataclass_options(MatcherOptions, "matcher", only=("matching",))
@dataclass_options(EstimationOptions, "estimation")
def bench_dtu(
    root: Path,
    out: Path,
    choice: DtuChoice,
    options: PairBenchOptions,
    matcher: MatcherOptions,
    estimation: EstimationOptions,
) -> None:
    """Repeat the paper's experiment on relative camera pose over DTU.

    ROOT is a folder with DTU as its authors ship it. The command runs `bench-pairs` on a fixed list
    of pairs of views, with rotations of 5 to 40 degrees. It writes the list as pairs.txt into DIR.
    """
    pairs = dtu_pairs(root, choice.scan, choice.light, choice.pairs)
    options = replace(options, out=out, protocol=choice.protocol)
    run_bench(pairs, options, CameraTrial(), matcher, estimation)
    with replaced(out / _LIST) as stage:  # last: a run that fails keeps the old list
        write_pairs(stage, pairs)
    click.echo(f"{out / _LIST}: {len(pairs)} pairs")
