"""`dgc-pose bench-pairs`: methods scored on pairs with known poses."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from importlib import import_module
from pathlib import Path
from typing import Any

import click
import numpy as np

from dgc_pose.benchmarks.changed_pairs import ChangedPairs, ImageChange
from dgc_pose.benchmarks.evaluate import Evaluation
from dgc_pose.benchmarks.methods import load_engines, parse_methods
from dgc_pose.benchmarks.posed_pairs import PairSet, RenderedPosedPairs
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
from dgc_pose.cli.bench_run import (
    RUN_FOLDER,
    MethodChoice,
    RunChoice,
    limit_option,
    listed_pairs,
    open_store,
    pair_list_argument,
    root_option,
    work,
)
from dgc_pose.cli.dataclass_options import dataclass_options
from dgc_pose.cli.guard import OutputFile
from dgc_pose.cli.options import split_names
from dgc_pose.errors import InputError
from dgc_pose.files.json_files import json_text
from dgc_pose.files.outputs import save_text, staged
from dgc_pose.matchers import SIFT
from dgc_pose.network.stored import shipped
from dgc_pose.system.options import MAX_SEED, check_options, option


@dataclass(frozen=True)
class SceneChoice:
    """Rendered pairs, instead of a list."""

    rendered: int | None = option(
        None,
        "Instead of LIST: N pairs of rendered scenes, textured with --photos.",
        metavar="N",
        min=1,
        max=10**6,
    )
    photos: Path | None = option(
        None,
        "Folder of photographs, as for training; those that training holds back are used.",
    )
    scene_seed: int = option(7, "Seed of the rendered scenes.", min=0, max=MAX_SEED)

    def __post_init__(self) -> None:
        check_options(self)


@click.command()
@pair_list_argument
@root_option
@dataclass_options(SceneChoice, "scenes")
@dataclass_options(ImageChange, "change")
@click.option(
    "--methods",
    default=lambda: ",".join([*shipped(), SIFT]),
    show_default="all shipped weights, and sift",
    help="Comma-separated names or paths of weights, sift, dis, each with options of "
    "its own, such as NAME:refine=none:runs=1; NAME/all takes all pixels that NAME maps into "
    "image 1.",
)
@limit_option
@click.option(
    "--out",
    type=RUN_FOLDER,
    metavar="DIR",
    help="Write results.csv (each pair as soon as it is done), summary.json and errors.png there.",
)
@click.option(
    "--json",
    "json_path",
    type=OutputFile(),
    metavar="PATH",
    help="Write the summary as JSON.",
)
@dataclass_options(RunChoice, "run")
@dataclass_options(MethodChoice, "defaults")
def bench_pairs(
    pair_list: str | None,
    root: str | None,
    scenes: SceneChoice,
    change: ImageChange,
    methods: str,
    limit: int | None,
    out: str | None,
    json_path: str | None,
    run: RunChoice,
    defaults: MethodChoice,
) -> None:
    """Score methods on the pairs of LIST, in SuperGlue's format, or on rendered pairs.

    Prints for each method the median errors, AUC@5/10/20 of the larger of rotation and folded
    translation error, the share of failures, and seconds a pair (matching and estimating). A pair
    without a pose counts as an infinite error.
    """
    if out is not None:
        import_module("dgc_pose.viz")  # it may be missing, which is better told before the work
    changed = change != ImageChange()
    if pair_list is not None and scenes.rendered is None and scenes.photos is None:
        listed = listed_pairs(pair_list, root, limit)
        pairs: PairSet[Any] = ChangedPairs(listed.pairs, change) if changed else listed
    elif changed:
        raise InputError("--roll, --roll-at-random, --shrink and --crop need a LIST of pairs")
    elif pair_list is None and scenes.rendered is not None and scenes.photos is not None:
        pairs = RenderedPosedPairs(scenes.photos, scenes.rendered, scenes.scene_seed)
    else:
        raise InputError("give a LIST of pairs, or --rendered with --photos, one of them")
    chosen = parse_methods(split_names(methods), defaults.options)
    images = (path for pair in getattr(pairs, "pairs", ()) for path in (pair.path1, pair.path2))
    with staged(json_path, inputs=images) as stage:
        engines = load_engines(chosen, device=run.device, runtime=run.runtime)
        evaluation = Evaluation(pairs, chosen, engines, run.workers, run.pairs_together)
        store = open_store(evaluation, out, run)
        work(evaluation, store)
        results = by_method(store.scores)
        if scenes.rendered is None:
            summaries: Sequence[MethodSummary] = [summarise(own) for own in results.values()]
            table = summary_table(summaries)
        else:
            summaries = with_maps = [summarise_maps(own) for own in results.values()]
            table = map_table(with_maps)
        data = json_text(summary_data(summaries))
        if json_path is not None:
            save_text(stage(json_path), data)
    if out is not None:
        _write_summary(out, data, results)
    click.echo(heading(defaults.estimation))
    click.echo(table)


def _write_summary(out: str, data: str, results: Mapping[str, Sequence[PairScore]]) -> None:
    """summary.json and errors.png beside results.csv."""
    from dgc_pose.viz import plot_errors, save_figure

    rotation, translation = (
        {method: np.array([getattr(one, name) for one in own]) for method, own in results.items()}
        for name in ("rotation_error_deg", "translation_folded_deg")
    )
    summary, errors = str(Path(out, "summary.json")), str(Path(out, "errors.png"))
    with staged(summary, errors) as stage:
        save_text(stage(summary), data)
        save_figure(plot_errors(rotation, translation), stage(errors))
