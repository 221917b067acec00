"""`dgc-pose bench-verdicts`: whether success can be trusted, and the error that a pose names."""

from __future__ import annotations

from pathlib import Path

import click

from dgc_pose.benchmarks.evaluate import Evaluation
from dgc_pose.benchmarks.methods import MethodOptions, load_engines, parse_methods
from dgc_pose.benchmarks.verdict_pairs import (
    VerdictPairs,
    listed,
    misleading,
    rendered,
    unrelated_photos,
    unrelated_scenes,
)
from dgc_pose.benchmarks.verdicts import gates_table, groups_table
from dgc_pose.cli.bench_run import RunChoice, open_store, run_options, work
from dgc_pose.cli.options import device_option
from dgc_pose.matching import DEFAULT_WEIGHTS
from dgc_pose.refinement import RefinementOptions


@click.command()
@click.option(
    "--photos",
    required=True,
    type=click.Path(path_type=Path),
    help="Folder of photographs, as for training; those that training holds back are used.",
)
@click.option(
    "--scene",
    "scenes",
    multiple=True,
    type=click.Path(path_type=Path, exists=True, file_okay=False),
    help="Photographs of one scene; pairs of different folders are unrelated. Twice at least.",
)
@click.option(
    "--list",
    "lists",
    multiple=True,
    metavar="LIST[,ROOT]",
    help="True pairs, in SuperGlue's format, with the folder of the images.",
)
@click.option("--limit", type=click.IntRange(1), help="Pairs of each list at most.")
@click.option("--unrelated", default=200, show_default=True, help="Pairs of photographs.")
@click.option(
    "--unrelated-scenes", "between", default=100, show_default=True, help="Pairs of --scene."
)
@click.option("--pairs", default=100, show_default=True, help="Rendered true pairs.")
@click.option("--misleading", "hard", default=10, show_default=True, help="Pairs of each kind.")
@click.option(
    "--method", default=DEFAULT_WEIGHTS, show_default=True, help="As one of bench-pairs --methods."
)
@click.option("--seed", default=11, show_default=True, help="Of the pairs.")
@click.option("--out", metavar="DIR", help="Write results.csv, a row at once for each pair.")
@run_options
@device_option
def bench_verdicts(
    photos: Path,
    scenes: tuple[Path, ...],
    lists: tuple[str, ...],
    limit: int | None,
    unrelated: int,
    between: int,
    pairs: int,
    hard: int,
    method: str,
    seed: int,
    out: str | None,
    run: RunChoice,
    device: str,
) -> None:
    """Measure verdicts on unrelated pairs, true pairs, and pairs that mislead.

    Prints two tables: what each kind of pair was called, and the gates on both halves.
    """
    methods = parse_methods([method], MethodOptions(refinement=RefinementOptions()))
    engines = load_engines(methods, device=device)
    groups = [unrelated_photos(photos, unrelated, seed)]
    if scenes:
        groups.append(unrelated_scenes(scenes, between, seed))
    groups.append(rendered(photos, pairs, seed))
    for entry in lists:
        pair_list, _, root = entry.partition(",")
        groups.append(listed(Path(pair_list), Path(root) if root else None, limit))
    count = sum(len(group.names) for group in groups)
    posed = VerdictPairs([*groups, *misleading(photos, hard, seed)])
    evaluation = Evaluation(posed, methods, engines, run.options(device))
    store = open_store(evaluation, out, device, {}, resume=run.resume)
    work(evaluation, store)
    # Gates are not chosen on what misleads.
    click.echo(f"{groups_table(store.scores)}\n\n{gates_table(store.scores[:count])}")
