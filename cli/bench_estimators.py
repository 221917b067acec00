"""`dgc-pose bench-estimators`: accuracy and time of the robust estimators."""

from __future__ import annotations

import click

from dgc_pose.benchmarks.estimators import STUDIES, Compared, compare, comparison_table
from dgc_pose.benchmarks.evaluate import Evaluation
from dgc_pose.benchmarks.methods import MethodOptions, load_engines, parse_methods
from dgc_pose.cli.bench_run import (
    RunChoice,
    limit_option,
    listed_pairs,
    pair_list_argument,
    root_option,
)
from dgc_pose.cli.dataclass_options import dataclass_options
from dgc_pose.cli.options import split_names
from dgc_pose.estimation import EstimationOptions
from dgc_pose.matching import DEFAULT_WEIGHTS


@click.command()
@pair_list_argument
@root_option
@limit_option
@click.option(
    "--methods",
    default=f"{DEFAULT_WEIGHTS}:refine=none,{DEFAULT_WEIGHTS}/all:max_matches=100000",
    show_default=True,
    help="Comma-separated methods that match the pairs, as in bench-pairs.",
)
@click.option(
    "--study",
    type=click.Choice([*STUDIES]),
    multiple=True,
    help="Study of synthetic matches; default: all.",
)
@click.option(
    "--seeds",
    type=click.IntRange(1, 10**6),
    default=5,
    show_default=True,
    help="Synthetic scenes of each study.",
)
@dataclass_options(RunChoice, "run", only=("device", "runtime"))
def bench_estimators(
    pair_list: str | None,
    root: str | None,
    limit: int | None,
    methods: str,
    study: tuple[str, ...],
    seeds: int,
    run: RunChoice,
) -> None:
    """Measure the estimators on synthetic matches, half of them wrong.

    With LIST, of pairs in SuperGlue's format, it gives the matches of each pair to the pose stage
    and to plain cv2.findEssentialMat, called as many times over permuted points, in this process.
    """
    if pair_list is None:
        for name in study or STUDIES:
            click.echo("\n".join([f"{name}, {seeds} scenes each", "", *STUDIES[name](seeds), ""]))
        return
    pairs = listed_pairs(pair_list, root, limit)
    options = EstimationOptions()
    chosen = parse_methods(split_names(methods), MethodOptions(estimation=options))
    engines = load_engines(chosen, device=run.device, runtime=run.runtime)
    evaluation = Evaluation(pairs, chosen, engines)
    found: dict[str, list[Compared]] = {method.name: [] for method in chosen}
    for pair in pairs.read():
        for job in evaluation.match([pair])[0]:
            found[job.method].append(compare(job.matches, job.truth, job.options))
    click.echo(
        f"{len(pairs.ids)} pairs; {options.runs} runs of {options.iterations} iterations; medians "
        "in degrees, a failure infinite"
    )
    click.echo(comparison_table([*found.items()], options.estimator))
