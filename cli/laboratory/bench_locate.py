"""`dgc-pose bench-locate`: images of a model left out and placed in it as queries."""

from dataclasses import asdict, dataclass
from pathlib import Path

import click

from dgc_pose.benchmarks.camera_trial import WithheldCameras
from dgc_pose.benchmarks.files import finite_data
from dgc_pose.benchmarks.locations import placed, report, thinned, true_model
from dgc_pose.cli.dataclass_options import dataclass_options
from dgc_pose.cli.guard import OutputFile
from dgc_pose.errors import ArgumentName, InputError
from dgc_pose.estimation import EstimationOptions
from dgc_pose.files.json_files import write_json
from dgc_pose.files.tables import aligned
from dgc_pose.images.cache import ImageCache
from dgc_pose.images.folder import search_images
from dgc_pose.localization.locate import Locator
from dgc_pose.matchers import MatcherOptions
from dgc_pose.system.options import option


@dataclass(frozen=True)
class LocateBenchOptions:
    """What is left out."""

    images: Path | None = option(None, "Folder of the images; default: images/ in MODEL.")
    k: WithheldCameras | None = option(None, "Withhold K, as for locate without one.", flag="--K")
    apart: int = option(
        1, "Names between a query and its database images, at least.", metavar="N", min=1, max=1000
    )
    count: int | None = option(
        None, "Place so many, evenly chosen; default: all.", metavar="N", min=1
    )
    other: Path | None = option(
        None, "Place the photographs of this folder, which show other places, instead."
    )
    json: str | None = option(
        None, "Write the score of each query.", metavar="PATH", type=OutputFile()
    )


@click.command()
@click.argument("path", metavar="MODEL", type=click.Path(path_type=Path))
@dataclass_options(LocateBenchOptions, "bench")
@dataclass_options(MatcherOptions, "matcher")
@dataclass_options(EstimationOptions, "estimation")
def bench_locate(
    path: Path, bench: LocateBenchOptions, matcher: MatcherOptions, estimation: EstimationOptions
) -> None:
    """Leave images out of a model, place them in it as queries, and compare with their poses.

    MODEL is as for locate; a list of pairs in SuperGlue's format; or a folder of posed RGB-D
    images. A location is right with R within 5 degrees and the position within 5 % of the extent.
    """
    model = true_model(path, bench.images)
    locator = Locator(model, matcher.load(ImageCache()), estimation)
    locator.describe()
    if bench.other is not None:
        names = search_images(bench.other).names
        if not names:
            raise InputError(ArgumentName("other"), f"{bench.other} holds no images")
        locations = [locator.locate(bench.other / name) for name in thinned(names, bench.count)]
        above = sum((location.probability or 0) > 0.5 for location in locations)
        click.echo(f"{above} of {len(locations)} placed above 0.5")
        return
    scores = []
    for name in thinned(sorted(model.poses), bench.count):
        scores.append(placed(locator, name, bench.apart, bench.k))
        score = scores[-1]
        click.echo(
            f"{name}: {score.status}, {score.rotation_deg:.3f} deg, {score.position_percent:.3f} %",
            err=True,
        )
    if bench.json is not None:
        write_json(Path(bench.json), finite_data([*map(asdict, scores)]))
    click.echo(aligned(report(scores)))
