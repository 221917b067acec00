"""`dgc-pose bench-pairs`: methods scored on a list of pairs with known poses."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from contextlib import ExitStack
from pathlib import Path

import click
import numpy as np
from tqdm import tqdm

from dgc_pose.benchmarks.methods import SIFT, load_methods
from dgc_pose.benchmarks.pair_list import Pair, read_pairs
from dgc_pose.benchmarks.pairs import PairResult, require_images, run, summarise
from dgc_pose.benchmarks.report import ResultsTable, heading, summary_data, summary_table
from dgc_pose.cli.options import (
    device_option,
    estimator_options,
    filter_options,
    refine_option,
    refinement_options,
    split_names,
)
from dgc_pose.cli.output import json_text
from dgc_pose.estimation import EstimationOptions
from dgc_pose.files import staged
from dgc_pose.matching import Matcher, MatchingOptions
from dgc_pose.network.weights import shipped
from dgc_pose.refinement import SourceName
from dgc_pose.viz import plot_errors, save_figure


@click.command()
@click.argument("pair_list", metavar="LIST")
@click.option("--root", help="Folder of the image paths; by default the list's own.")
@click.option(
    "--methods",
    default=lambda: ",".join([*shipped(), SIFT]),
    show_default="all shipped weights, and sift",
    help="Names or paths of weights, or sift (OpenCV's), with commas between.",
)
@click.option("--limit", type=click.IntRange(min=1), metavar="N", help="Only the first N pairs.")
@click.option(
    "--out",
    metavar="DIR",
    help="Write results.csv (a row at once for each pair), summary.json and errors.png there.",
)
@click.option("--json", "json_path", metavar="PATH", help="Write the summary as JSON.")
@device_option
@filter_options
@refine_option
@estimator_options
def bench_pairs(
    pair_list: str,
    root: str | None,
    methods: str,
    limit: int | None,
    out: str | None,
    json_path: str | None,
    device: str,
    filters: MatchingOptions,
    refine: SourceName | None,
    estimation: EstimationOptions,
) -> None:
    """Score methods on the pairs of LIST, in SuperGlue's format.

    Prints for each method the median errors, AUC@5/10/20 of the larger of rotation and folded
    translation error, the share of failures, and seconds a pair (matching and estimating). A pair
    without a pose counts as an infinite error.
    """
    pairs = read_pairs(pair_list, root)[:limit]
    require_images(pairs)
    with staged(json_path) as stage:
        matchers = load_methods(
            split_names(methods),
            device=device,
            options=filters,
            refinement=refinement_options(refine, filters),
        )
        results = _run(pairs, matchers, estimation, None if out is None else Path(out))
        summaries = [summarise(own) for own in results.values()]
        data = json_text(summary_data(summaries))
        if json_path is not None:
            stage(json_path).write_text(data, encoding="utf-8")
    if out is not None:
        _write_summary(out, data, results)
    click.echo(heading(estimation))
    click.echo(summary_table(summaries))


def _run(
    pairs: Sequence[Pair],
    matchers: Mapping[str, Matcher],
    estimation: EstimationOptions,
    out: Path | None,
) -> dict[str, list[PairResult]]:
    """All results by method, each on disk as soon as it is there."""
    results: dict[str, list[PairResult]] = {name: [] for name in matchers}
    with ExitStack() as stack:
        table = None
        if out is not None:
            out.mkdir(parents=True, exist_ok=True)
            stream = stack.enter_context((out / "results.csv").open("w", newline=""))
            table = ResultsTable(stream)
        total = len(pairs) * len(matchers)
        progress = tqdm(run(pairs, matchers, estimation), total=total, unit="pair", disable=None)
        for result in progress:
            results[result.method].append(result)
            if table is not None:
                table.add(result)
    return results


def _write_summary(out: str, data: str, results: Mapping[str, Sequence[PairResult]]) -> None:
    """summary.json and errors.png beside results.csv."""
    rotation = {
        method: np.array([result.rotation_error_deg for result in own])
        for method, own in results.items()
    }
    translation = {
        method: np.array([result.translation_folded_deg for result in own])
        for method, own in results.items()
    }
    summary, errors = str(Path(out, "summary.json")), str(Path(out, "errors.png"))
    with staged(summary, errors) as stage:
        stage(summary).write_text(data, encoding="utf-8")
        save_figure(plot_errors(rotation, translation), stage(errors))
