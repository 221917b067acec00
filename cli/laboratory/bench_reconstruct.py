"""`dgc-pose bench-reconstruct`: reconstructions compared with true cameras."""

from dataclasses import dataclass
from pathlib import Path

import click

from dgc_pose.batch.options import BatchOptions
from dgc_pose.batch.source import parse_pair_choice
from dgc_pose.benchmarks.camera_trial import WithheldCameras
from dgc_pose.benchmarks.files import finite_data, split_names
from dgc_pose.benchmarks.reconstructions import (
    COLMAP_SIFT,
    COLUMNS,
    run_method,
    views_of_list,
)
from dgc_pose.benchmarks.summary import summary_table
from dgc_pose.cli.dataclass_options import dataclass_options
from dgc_pose.cli.guard import OutputFolder
from dgc_pose.colmap.options import ReconstructionOptions
from dgc_pose.errors import InputError
from dgc_pose.estimation import EstimationOptions
from dgc_pose.files.json_files import write_json
from dgc_pose.matching import DEFAULT_WEIGHTS
from dgc_pose.system.options import option

_SHARED = ("per_image", "mapper", "refine_intrinsics")  # with reconstruct


@dataclass(frozen=True)
class ReconstructBenchOptions:
    """What is compared with what."""

    out: Path = option(
        help="Folder of the results; created if missing.",
        metavar="DIR",
        type=OutputFolder("summary.json", path_type=Path),
    )
    truth: Path = option(
        help="True cameras: a list of pairs in SuperGlue's format, whose translations have one "
        "unit, as that of dtu-pairs.",
        metavar="LIST",
    )
    k: WithheldCameras | None = option(
        None, "Withhold K, as for reconstruct without one.", flag="--K"
    )
    methods: str = option(
        f"{DEFAULT_WEIGHTS},{COLMAP_SIFT}",
        f"Comma-separated names or paths of weights, sift, and {COLMAP_SIFT}, COLMAP's own "
        "pipeline over all pairs.",
    )
    pairs: str = option("exhaustive", "As for batch.")


@click.command()
@click.argument("folder", metavar="FOLDER", type=click.Path(path_type=Path))
@dataclass_options(ReconstructBenchOptions, "bench")
@dataclass_options(ReconstructionOptions, "reconstruction", only=_SHARED)
@dataclass_options(BatchOptions, "work", only=("workers", "memory", "resume"))
@dataclass_options(EstimationOptions, "estimation")
def bench_reconstruct(
    folder: Path,
    bench: ReconstructBenchOptions,
    reconstruction: ReconstructionOptions,
    work: BatchOptions,
    estimation: EstimationOptions,
) -> None:
    """Reconstruct a scene with known cameras, and compare positions and rotations.

    K is known and stays fixed, unless --K auto withholds it. Positions are compared after the best
    similarity; "% of extent" is their rms over the largest distance of two cameras. "f off" is the
    mean error of the model's focal lengths, "pooled f off" of those that all pairs give together;
    AUC@5 is of the pairs' poses. All methods map with the same options.
    """
    out, truth = bench.out, bench.truth
    if not folder.is_dir():
        raise InputError(f"{folder}: no such folder of images")
    views = views_of_list(truth, folder)
    if len(views.poses) < 3:
        raise InputError(f"{folder}: {len(views.poses)} images; a reconstruction needs 3")
    setting = parse_pair_choice(bench.pairs), reconstruction, estimation, work, bench.k
    out.mkdir(parents=True, exist_ok=True)
    scores = []
    for method in split_names(bench.methods):
        score = run_method(method, views, out / Path(method).stem, *setting)
        scores.append(score)
        click.echo(f"{method}: {score['registered']} of {score['images']} images", err=True)
    write_json(out / "summary.json", finite_data({"methods": scores}))
    click.echo(summary_table(scores, COLUMNS))
