"""`dgc-pose bench-model`: compare reconstructions and locations with true cameras."""

from dataclasses import dataclass
from pathlib import Path
from typing import Any

import click

from dgc_pose.batch.options import BatchOptions
from dgc_pose.batch.source import parse_pair_choice
from dgc_pose.benchmarks.models import (
    COLMAP_SIFT,
    COLUMNS,
    location_report,
    placed,
    run_method,
    thinned,
    true_model,
)
from dgc_pose.benchmarks.report import Summary, finite_data, split_names, summary_table
from dgc_pose.cli.guard import OutputFolder
from dgc_pose.cli.options import dataclass_options
from dgc_pose.colmap.options import ReconstructionOptions
from dgc_pose.errors import ArgumentName, InputError
from dgc_pose.estimation import EstimationOptions
from dgc_pose.images.cache import ImageCache
from dgc_pose.images.folder import search_images
from dgc_pose.localization.locate import Locator
from dgc_pose.matchers import MatcherOptions
from dgc_pose.matching import DEFAULT_WEIGHTS
from dgc_pose.system.options import option
from dgc_pose.system.texts import aligned, write_json

_SHARED = ("per_image", "mapper", "refine_intrinsics")  # options shared with reconstruct


@dataclass(frozen=True)
class ModelBenchOptions:
    """The methods and images that are compared with the model."""

    out: Path = option(
        help="Folder of the results, summary.json and reconstructions; created if missing.",
        metavar="DIR",
        type=OutputFolder("summary.json", path_type=Path),
    )
    images: Path | None = option(
        None, "Folder of the images; default: images/ in MODEL, or the folder that a list names."
    )
    methods: str = option(
        DEFAULT_WEIGHTS,
        "Comma-separated names or paths of weights or other matchers; for reconstructions "
        f"also {COLMAP_SIFT}, COLMAP's own pipeline over all pairs.",
    )
    pairs: str = option("exhaustive", "Pairs of a reconstruction, as for batch.")
    locate: bool = option(
        False, "Remove each image from the model and place it there, instead of reconstructing."
    )
    apart: int = option(
        1, "Names between a query and its database images, at least.", metavar="N", min=1, max=1000
    )
    count: int | None = option(
        None, "Number of images to place, evenly chosen; default: all.", metavar="N", min=1
    )
    other: Path | None = option(
        None, "Place the photographs of this folder, which show other places, instead."
    )


@click.command()
@click.argument("path", metavar="MODEL", type=click.Path(path_type=Path))
@dataclass_options(ModelBenchOptions, "bench")
@dataclass_options(ReconstructionOptions, "reconstruction", only=_SHARED)
@dataclass_options(BatchOptions, "work", only=("workers", "memory", "resume"))
@dataclass_options(EstimationOptions, "estimation")
def bench_model(
    path: Path,
    bench: ModelBenchOptions,
    reconstruction: ReconstructionOptions,
    work: BatchOptions,
    estimation: EstimationOptions,
) -> None:
    """Reconstruct a scene of known cameras, or place its images, and compare with the truth.

    MODEL is a model as for locate; a list of pairs in SuperGlue's format, whose translations have a
    common unit; or a folder of posed RGB-D images. K is known.

    Positions of a reconstruction are compared after the best similarity. "% of extent" is their rms
    error over the largest distance of two cameras. AUC@5 refers to the poses of pairs. All methods
    use the same options for mapping.

    A location is right if R is within 5 degrees and the position within 5 % of the extent.
    """
    model = true_model(path, bench.images)
    locates = bench.locate or bench.other is not None
    choice = parse_pair_choice(bench.pairs)
    bench.out.mkdir(parents=True, exist_ok=True)
    results: list[Summary] = []
    for method in split_names(bench.methods):
        if locates:
            locator = Locator(model, MatcherOptions(method).load(ImageCache()), estimation)
            results.append({"method": method, "queries": _placed(locator, bench)})
        else:
            out = bench.out / Path(method).stem
            score = run_method(method, model, out, choice, reconstruction, estimation, work)
            results.append(score)
            click.echo(f"{method}: {score['registered']} of {score['images']} images", err=True)
    write_json(bench.out / "summary.json", finite_data({"methods": results}))
    if not locates:
        click.echo(summary_table(results, COLUMNS))


def _placed(locator: Locator, bench: ModelBenchOptions) -> list[dict[str, Any]]:
    """Locate the queries, print a report, and return the score of each."""
    locator.describe()
    if bench.other is not None:
        names = search_images(bench.other).names
        if not names:
            raise InputError(ArgumentName("other"), f"{bench.other} holds no images")
        chosen = thinned(names, bench.count)
        locations = [locator.locate(bench.other / name) for name in chosen]
        above = sum((location.probability or 0) > 0.5 for location in locations)
        click.echo(f"{above} of {len(locations)} placed above 0.5")
        return [
            {"name": name, "probability": location.probability}
            for name, location in zip(chosen, locations, strict=True)
        ]
    scores = []
    for name in thinned(sorted(locator.model.poses), bench.count):
        scores.append(placed(locator, name, bench.apart))
        found = "{status}, {rotation_deg:.3f} deg, {position_percent:.3f} %"
        click.echo(f"{name}: {found.format(**scores[-1])}", err=True)
    click.echo(aligned(location_report(scores)))
    return scores
