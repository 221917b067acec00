"""`dgc-pose bench-reconstruct`: reconstructions compared with true cameras."""

from __future__ import annotations

import dataclasses
from pathlib import Path

import click

from dgc_pose.batch.pair_choice import parse_pair_choice
from dgc_pose.benchmarks.posed_views import views_of_dtu, views_of_list
from dgc_pose.benchmarks.reconstructions import (
    COLMAP_SIFT,
    Setting,
    run_method,
    score_table,
)
from dgc_pose.cli.batch import WorkChoice, batch_options
from dgc_pose.cli.dataclass_options import dataclass_options
from dgc_pose.cli.guard import OutputFolder
from dgc_pose.cli.options import split_names
from dgc_pose.colmap.options import ReconstructionOptions
from dgc_pose.errors import InputError
from dgc_pose.estimation import EstimationOptions
from dgc_pose.files.json_files import finite_or_none, write_json
from dgc_pose.matching import DEFAULT_WEIGHTS


@click.command()
@click.argument("folder", metavar="FOLDER", type=click.Path(path_type=Path))
@click.option(
    "--out",
    type=OutputFolder("summary.json", "images", path_type=Path),
    required=True,
    metavar="DIR",
)
@click.option(
    "--truth",
    type=click.Path(path_type=Path),
    required=True,
    metavar="LIST|DIR",
    help="True cameras: a list of pairs in SuperGlue's format, whose translations have one unit, "
    "or DTU's folder Calibration/cal18.",
)
@click.option(
    "--methods",
    default=f"{DEFAULT_WEIGHTS},{COLMAP_SIFT}",
    show_default=True,
    help=f"Comma-separated names or paths of weights, sift, and {COLMAP_SIFT}, COLMAP's own "
    "pipeline over all pairs.",
)
@click.option("--pairs", default="exhaustive", show_default=True, help="As for batch.")
@click.option(
    "--scale",
    type=click.FloatRange(min=0, max=1, min_open=True),
    default=1.0,
    help="Resize the images by this; 0.5 leaves a quarter of the pixels.",
)
@click.option("--every", type=click.IntRange(min=1), default=1, help="Only every N-th image.")
@dataclass_options(ReconstructionOptions, "reconstruction")
@dataclass_options(WorkChoice, "work", only=("workers", "memory", "resume"))
@dataclass_options(EstimationOptions, "estimation")
def bench_reconstruct(
    folder: Path,
    out: Path,
    truth: Path,
    methods: str,
    pairs: str,
    scale: float,
    every: int,
    reconstruction: ReconstructionOptions,
    work: WorkChoice,
    estimation: EstimationOptions,
) -> None:
    """Reconstruct a scene with known cameras, and compare positions and rotations.

    K is known and stays fixed. Positions are compared after the best similarity; "% of extent" is
    their rms over the largest distance of two cameras. All methods map with the same options.
    """
    if not folder.is_dir():
        raise InputError(f"{folder}: no such folder of images")
    views = views_of_dtu(truth, folder) if truth.is_dir() else views_of_list(truth, folder)
    views = views.every(every)
    if len(views.poses) < 3:
        raise InputError(f"{folder}: {len(views.poses)} images; a reconstruction needs 3")
    options = batch_options(work)
    mapping = dataclasses.replace(reconstruction.mapping, mapper_threads=options.workers)
    reconstruction = dataclasses.replace(reconstruction, mapping=mapping)
    setting = Setting(parse_pair_choice(pairs), reconstruction, estimation, options)
    out.mkdir(parents=True, exist_ok=True)
    scores = []
    if scale != 1:
        views = views.resized(scale, out / "images")  # a later --resume reads them again
    for method in split_names(methods):
        score = run_method(method, views, out / Path(method).stem, setting)
        scores.append(score)
        click.echo(f"{method}: {score.registered} of {score.images} images", err=True)
    data = [
        {
            key: finite_or_none(value) if isinstance(value, float) else value
            for key, value in dataclasses.asdict(one).items()
        }
        for one in scores
    ]
    write_json(out / "summary.json", {"methods": data})
    click.echo(score_table(scores))
