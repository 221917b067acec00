"""`dgc-pose batch`: the poses and matches of many pairs, from a folder, a list or a database."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Any

import click

from dgc_pose.batch.options import BatchOptions
from dgc_pose.cli.dataclass_options import dataclass_options
from dgc_pose.cli.guard import OutputFolder
from dgc_pose.cli.options import KChoice
from dgc_pose.cli.progress import progress_bars
from dgc_pose.errors import InputError
from dgc_pose.estimation import EstimationOptions
from dgc_pose.matchers import MatcherOptions
from dgc_pose.system.options import option

if TYPE_CHECKING:
    from dgc_pose.batch.run import Batch

CAMERAS_SHOWN = 5
_SOURCES = {"size": "image's size", "exif": "EXIF data", "given": "K given"}


OUT = click.option(
    "--out",
    type=OutputFolder(path_type=Path),
    required=True,
    metavar="DIR",
    help="Folder of the results.",
)


@dataclass(frozen=True)
class SourceChoice(KChoice):
    """The images, their pairs and cameras."""

    root: Path | None = option(None, "Of a list's image names; default: its own folder.")
    pairs: str | None = option(
        None,
        "exhaustive; sequential:W, images at most W apart in the order of their names; auto:K, the "
        "K most similar images of each. Default: exhaustive for up to 20 images of a folder, "
        "auto:10 for more.",
        metavar="WAY",
    )


def work_through(
    source: str,
    out: Path,
    inputs: SourceChoice,
    work: BatchOptions,
    matcher: MatcherOptions,
    estimation: EstimationOptions,
    default_pairs: Callable[[int], str] | None = None,
    least_images: int = 2,
) -> Batch:
    """Run the batch that the options describe, with a progress bar on a terminal.

    default_pairs: from the number of images of a folder to its --pairs, if that is absent. Raises
    InputError for fewer than `least_images`.
    """
    from dgc_pose.batch.pair_choice import parse_pair_choice
    from dgc_pose.batch.run import run_batch
    from dgc_pose.batch.source import open_source
    from dgc_pose.cameras.calibration import read_calibration

    images = open_source(Path(source), inputs.root)
    for line in images.left_out:
        click.echo(f"warning: {line}", err=True)
    if len(images.names) < least_images:
        raise InputError(f"{source}: {len(images.names)} images, and a model needs {least_images}")
    pairs = inputs.pairs
    if pairs is None and images.pairs is None and default_pairs is not None:
        pairs = default_pairs(len(images.names))
    choice = None if pairs is None else parse_pair_choice(pairs)
    with progress_bars() as progress:
        return run_batch(
            images,
            read_calibration(inputs.k, details=inputs.details),
            choice,
            out,
            matcher=matcher,
            estimation=estimation,
            options=work,
            progress=progress,
        )


def report(batch: Batch) -> None:
    """Print the summary of a batch, the images that could not be used, and the first warning."""
    from dgc_pose.batch.rows import FAILED

    summary = batch.summary
    for name, reason in summary["bad_images"].items():
        click.echo(f"bad image {name}: {reason}", err=True)
    if failed := [row for row in batch.rows if row.status == FAILED]:
        first = failed[0]
        click.echo(
            f"{len(failed)} pairs failed (first: {first.name1} {first.name2}: {first.reason}): "
            "--resume matches them again",
            err=True,
        )
    if warnings := [text for camera in batch.plan.cameras.values() for text in camera.warnings]:
        more = f" (and {len(warnings) - 1} more images)" if len(warnings) > 1 else ""
        click.echo(f"warning: {warnings[0]}{more}", err=True)
    echo_cameras(summary["cameras"])
    statuses = ", ".join(f"{name} {count}" for name, count in summary["by_status"].items())
    click.echo(
        f"{batch.folder}: {summary['poses']} poses of {summary['pairs']} pairs ({statuses}), "
        f"{summary['images']} images, {summary['matched_now']} pairs in {summary['seconds']:.0f} s"
    )


def echo_cameras(cameras: Sequence[Mapping[str, Any]]) -> None:
    """Print the pooled cameras of a summary: each of the first, and how many more there are."""
    for number, camera in enumerate(cameras[:CAMERAS_SHOWN], start=1):
        focal, std = camera["focal_px"], camera["focal_std"]
        images = "1 image" if camera["images"] == 1 else f"{camera['images']} images"
        what = f"camera {number} ({images}): f = {focal:.0f} +- {focal * std:.0f} px"
        if camera["focal_source"] == "matches":
            pairs = "1 pair" if camera["pairs"] == 1 else f"{camera['pairs']} pairs"
            click.echo(f"{what} from {pairs}")
        else:
            click.echo(f"{what} from the {_SOURCES[camera['focal_source']]}: no pair tells it")
    if len(cameras) > CAMERAS_SHOWN:
        click.echo(f"{len(cameras) - CAMERAS_SHOWN} more cameras: see cameras.csv")


@click.command()
@click.argument("source", metavar="SOURCE")
@OUT
@dataclass_options(SourceChoice, "inputs")
@dataclass_options(BatchOptions, "work")
@dataclass_options(MatcherOptions, "matcher")
@dataclass_options(EstimationOptions, "estimation")
def batch(
    source: str,
    out: Path,
    inputs: SourceChoice,
    work: BatchOptions,
    matcher: MatcherOptions,
    estimation: EstimationOptions,
) -> None:
    """Match many pairs of photographs and estimate their poses.

    SOURCE is a folder of photographs, a list of pairs (two names a line, SuperGlue's lines, or a
    .csv), or a COLMAP database (.db).

    Writes pairs.jsonl (or .parquet), a row for each pair: status, R, t, expected errors, counts;
    matches.h5, the matches in hloc's layout; and summary.json. With --K auto also cameras.csv, the
    cameras that all pairs together tell, which --K reads. A bad image is reported and does
    not stop the batch. A batch that was stopped continues with --resume.
    """
    report(work_through(source, out, inputs, work, matcher, estimation))
