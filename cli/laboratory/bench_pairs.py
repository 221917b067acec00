"""`dgc-pose bench-pairs`: methods scored on pairs with known poses."""

from dataclasses import dataclass
from importlib import import_module
from pathlib import Path
from typing import Any

import click

from dgc_pose.benchmarks.camera_trial import CameraTrial
from dgc_pose.benchmarks.evaluate import Evaluation
from dgc_pose.benchmarks.files import split_names
from dgc_pose.benchmarks.methods import load_matchers, parse_methods
from dgc_pose.benchmarks.posed_pairs import (
    ListedPairs,
    PairSet,
    RenderedPosedPairs,
    require_images,
)
from dgc_pose.benchmarks.scores import CameraScore, PairScore
from dgc_pose.benchmarks.summary import (
    by_method,
    camera_table,
    columns,
    heading,
    summarise,
    summary_data,
    summary_table,
)
from dgc_pose.cameras.pair_list import read_pairs
from dgc_pose.cli.dataclass_options import NamedPath, dataclass_options
from dgc_pose.cli.guard import OutputFile
from dgc_pose.cli.laboratory.bench_run import METHOD_FIELDS, RUN_FOLDER, RunChoice, work
from dgc_pose.errors import InputError, require
from dgc_pose.estimation import EstimationOptions
from dgc_pose.files.json_files import json_text
from dgc_pose.files.outputs import replaced, require_no_input, save_text, staged, write_text
from dgc_pose.matchers import MatcherOptions
from dgc_pose.network.config import DEFAULT_WEIGHTS
from dgc_pose.system.options import MAX_SEED, option


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
    rendered: int | None = option(
        None,
        "Instead of LIST: N pairs of rendered scenes, textured with --photos.",
        metavar="N",
        min=1,
        max=10**6,
    )
    photos: Path | None = option(
        None, "Folder of photographs, as for training; those that training holds back are used."
    )
    scene_seed: int = option(7, "Seed of the rendered scenes.", min=0, max=MAX_SEED)
    out: str | None = option(
        None,
        "Write results.csv (each pair as soon as it is done), summary.json and errors.png there.",
        metavar="DIR",
        type=RUN_FOLDER,
    )
    json_path: str | None = option(
        None, "Write the summary as JSON.", flag="--json", metavar="PATH", type=OutputFile()
    )

    def pair_set(self, pair_list: str | None, *, trial: bool) -> PairSet[Any]:
        """The data set. trial: whether some method gets other cameras than the list's.

        Raises InputError or ImageError if it cannot be made.
        """
        if pair_list is not None and self.rendered is None and self.photos is None:
            pairs = read_pairs(pair_list, self.root)[:: self.every][: self.limit]
            require_images(pairs)
            return ListedPairs(pairs, CameraScore if trial else PairScore)
        if trial:
            raise InputError("--K and --K-scale need a LIST of pairs")
        if pair_list is not None or self.rendered is None or self.photos is None:
            raise InputError("give a LIST of pairs, or --rendered with --photos, one of them")
        require({"--rendered": "torch"})
        return RenderedPosedPairs(self.photos, self.rendered, self.scene_seed)


@click.command()
@click.argument("pair_list", metavar="[LIST]", required=False, type=click.Path())
@dataclass_options(PairBenchOptions, "options")
@dataclass_options(CameraTrial, "cameras")
@click.option(
    "--methods",
    default=f"{DEFAULT_WEIGHTS},sift",
    show_default=True,
    help="Comma-separated names or paths of weights or other matchers (sift, dis, "
    "deepmatching), each with options of "
    "its own, such as NAME:refine=none:runs=1; NAME/all takes all pixels that NAME maps into "
    "image 1.",
)
@dataclass_options(RunChoice, "run")
@dataclass_options(MatcherOptions, "matcher", only=METHOD_FIELDS)
@dataclass_options(EstimationOptions, "estimation")
def bench_pairs(
    pair_list: str | None,
    options: PairBenchOptions,
    cameras: CameraTrial,
    methods: str,
    run: RunChoice,
    matcher: MatcherOptions,
    estimation: EstimationOptions,
) -> None:
    """Score methods on the pairs of LIST, in SuperGlue's format, or on rendered pairs.

    Prints for each method the median errors, AUC@5/10/20 of the larger of rotation and folded
    translation error, the share of failures, and seconds a pair (matching and estimating). A pair
    without a pose counts as an infinite error.

    With --K and its like the K of LIST are withheld or changed, for all methods or, by NAME:K=auto,
    NAME:K=auto:shared or NAME:K_scale=0.8, for one of several that share their matches. Errors are
    of the true cameras as before; a second table has the focal lengths and what the poses state.
    """
    if options.out is not None:
        import_module("dgc_pose.viz")  # it may be missing, which is better known before the work
    chosen = parse_methods(split_names(methods), matcher, estimation, cameras=cameras)
    trial = any(method.cameras.reports for method in chosen)
    pairs = options.pair_set(pair_list, trial=trial)
    images = (path for pair in getattr(pairs, "pairs", ()) for path in (pair.path1, pair.path2))
    require_no_input([options.json_path or ""], images)
    with staged(options.json_path) as stage:
        matchers = load_matchers(chosen, device=run.device, runtime=run.runtime)
        evaluation = Evaluation(pairs, chosen, matchers, run.workers)
        results = by_method(work(evaluation, options.out, run))
        summaries = [summarise(rows) for rows in results.values()]
        data = json_text(summary_data(summaries))
        if options.json_path is not None:
            save_text(stage(options.json_path), data)
    if options.out is not None:
        from dgc_pose.benchmarks.curves import plot_errors
        from dgc_pose.viz import save_figure

        numbers = columns(row for rows in results.values() for row in rows)
        rotation, translation = (
            {method: column[name] for method, column in numbers.items()}
            for name in ("rotation_error_deg", "translation_folded_deg")
        )
        write_text(Path(options.out, "summary.json"), data)
        with replaced(Path(options.out, "errors.png")) as file:
            save_figure(plot_errors(rotation, translation), file)
    click.echo(f"{heading(estimation)}\n{summary_table(summaries)}")
    if trial:
        click.echo(f"\n{camera_table(summaries)}")
