"""`dgc-pose bench-synthetic`: dense maps scored on fixed sets of synthetic pairs."""

from dataclasses import dataclass

import click

from dgc_pose.benchmarks.files import split_names
from dgc_pose.benchmarks.map_report import (
    HEADING,
    figures_table,
    groups_of,
    reliability_lines,
    summaries,
)
from dgc_pose.cli.dataclass_options import dataclass_options
from dgc_pose.cli.laboratory.map_bench import MapBenchOptions, run_map_bench
from dgc_pose.system.options import MAX_SEED, option


@dataclass(frozen=True)
class SyntheticOptions:
    """Which pairs are made."""

    photos: str = option(
        help="Folder of photographs, of which those that training holds back are used.",
        metavar="DIR",
    )
    sets: str | None = option(None, "Comma-separated sets; default: all of them.")
    pairs: int = option(100, "Pairs of each set.", metavar="N", min=1, max=10**6)
    seed: int = option(0, "The same seed, the same pairs.", min=0, max=MAX_SEED)
    changed: bool = option(
        False,
        "With the trainer's changes of light, blur and noise, and with occluders in warped views; "
        "the paper's sets have none of these.",
    )


@click.command()
@dataclass_options(SyntheticOptions, "made")
@dataclass_options(MapBenchOptions, "bench")
def bench_synthetic(made: SyntheticOptions, bench: MapBenchOptions) -> None:
    """Score the dense maps of networks and other matchers on synthetic pairs with exact truth.

    Sets: affine, affine-tps (half of each) and homography by the paper's ranges, and scenes,
    ray-cast in 3D, whose cameras differ by 5 to 30 degrees.
    """
    from dgc_pose.benchmarks.synthetic import SETS, SYNTHETIC, synthetic_set

    names = SETS if made.sets is None else split_names(made.sets)
    data = synthetic_set(made.photos, names, made.pairs, made.seed, changed=made.changed)
    light = (
        "with changes of light and occluders" if made.changed else "light as it is, no occluders"
    )
    photographs = data.facts["photographs"]
    about = f"{photographs} photographs that training holds back, seed {made.seed}, {light}"

    scores = run_map_bench(bench, data)
    tables = [figures_table(summaries(scores, group), first=group) for group in groups_of(scores)]
    blocks = [f"{about}\n{HEADING}", *tables, SYNTHETIC, *reliability_lines(scores)]
    click.echo("\n\n".join(blocks))
