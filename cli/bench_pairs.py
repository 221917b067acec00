"""`dgc-pose bench-pairs`: methods scored on pairs with known poses."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

import click
import numpy as np

from dgc_pose.benchmarks.evaluate import Evaluation
from dgc_pose.benchmarks.methods import MethodOptions, load_engines, parse_methods
from dgc_pose.benchmarks.pair_list import read_pairs
from dgc_pose.benchmarks.posed_pairs import ListedPairs, PairSet, RenderedPairs, require_images
from dgc_pose.benchmarks.scores import PairScore
from dgc_pose.benchmarks.summary import (
    MethodSummary,
    by_method,
    heading,
    map_table,
    summarise,
    summarise_maps,
    summary_data,
    summary_table,
)
from dgc_pose.cli.bench_run import RunChoice, open_store, run_options, work
from dgc_pose.cli.options import (
    device_option,
    estimator_options,
    filter_options,
    refine_option,
    refinement_options,
    split_names,
)
from dgc_pose.cli.output import json_text
from dgc_pose.errors import InputError
from dgc_pose.estimation import EstimationOptions
from dgc_pose.files import staged
from dgc_pose.matchers import SIFT
from dgc_pose.matching import MatchingOptions
from dgc_pose.network.weights import shipped
from dgc_pose.refinement import SourceName
from dgc_pose.viz import plot_errors, save_figure


@click.command()
@click.argument("pair_list", metavar="[LIST]", required=False)
@click.option("--root", help="Folder of the image paths; by default the list's own.")
@click.option(
    "--rendered",
    type=click.IntRange(min=1),
    metavar="N",
    help="Instead of LIST: N pairs of rendered scenes, textured with --photos.",
)
@click.option(
    "--photos",
    type=click.Path(path_type=Path),
    help="Folder of photographs, as for training; those that training holds back are used.",
)
@click.option("--scene-seed", default=7, show_default=True, help="Of the rendered scenes.")
@click.option(
    "--methods",
    default=lambda: ",".join([*shipped(), SIFT]),
    show_default="all shipped weights, and sift",
    help="With commas between: names or paths of weights, sift, dis, farneback, each with options "
    "of its own if need be, as NAME:refine=none:runs=1; NAME/all takes all pixels that NAME maps "
    "into image 1.",
)
@click.option("--limit", type=click.IntRange(min=1), metavar="N", help="Only the first N pairs.")
@click.option(
    "--out",
    metavar="DIR",
    help="Write results.csv (a row at once for each pair), summary.json and errors.png there.",
)
@click.option("--json", "json_path", metavar="PATH", help="Write the summary as JSON.")
@run_options
@device_option
@filter_options
@refine_option
@estimator_options
def bench_pairs(
    pair_list: str | None,
    root: str | None,
    rendered: int | None,
    photos: Path | None,
    scene_seed: int,
    methods: str,
    limit: int | None,
    out: str | None,
    json_path: str | None,
    run: RunChoice,
    device: str,
    filters: MatchingOptions,
    refine: SourceName | None,
    estimation: EstimationOptions,
) -> None:
    """Score methods on the pairs of LIST, in SuperGlue's format, or on rendered pairs.

    Prints for each method the median errors, AUC@5/10/20 of the larger of rotation and folded
    translation error, the share of failures, and seconds a pair (matching and estimating). A pair
    without a pose counts as an infinite error.
    """
    pairs = _pairs(pair_list, root, limit, rendered, photos, scene_seed)
    defaults = MethodOptions(filters, refinement_options(refine, filters), estimation)
    chosen = parse_methods(split_names(methods), defaults)
    with staged(json_path) as stage:
        engines = load_engines(chosen, device=device)
        evaluation = Evaluation(pairs, chosen, engines, run.options(device))
        store = open_store(evaluation, out, device, {}, resume=run.resume)
        work(evaluation, store)
        results = by_method(store.scores)
        if rendered is None:
            summaries: Sequence[MethodSummary] = [summarise(own) for own in results.values()]
            table = summary_table(summaries)
        else:
            summaries = with_maps = [summarise_maps(own) for own in results.values()]
            table = map_table(with_maps)
        data = json_text(summary_data(summaries))
        if json_path is not None:
            stage(json_path).write_text(data, encoding="utf-8")
    if out is not None:
        _write_summary(out, data, results)
    click.echo(heading(estimation))
    click.echo(table)


def _pairs(
    pair_list: str | None,
    root: str | None,
    limit: int | None,
    rendered: int | None,
    photos: Path | None,
    scene_seed: int,
) -> PairSet[Any]:
    if pair_list is not None and rendered is None:
        pairs = read_pairs(pair_list, root)[:limit]
        require_images(pairs)
        return ListedPairs(pairs)
    if pair_list is None and rendered is not None and photos is not None:
        return RenderedPairs(photos, rendered, scene_seed)
    raise InputError("give a LIST of pairs, or --rendered with --photos, one of them")


def _write_summary(out: str, data: str, results: Mapping[str, Sequence[PairScore]]) -> None:
    """summary.json and errors.png beside results.csv."""
    rotation, translation = (
        {method: np.array([getattr(one, name) for one in own]) for method, own in results.items()}
        for name in ("rotation_error_deg", "translation_folded_deg")
    )
    summary, errors = str(Path(out, "summary.json")), str(Path(out, "errors.png"))
    with staged(summary, errors) as stage:
        stage(summary).write_text(data, encoding="utf-8")
        save_figure(plot_errors(rotation, translation), stage(errors))
