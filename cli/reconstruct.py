"""`dgc-pose reconstruct`: from a folder of photographs to a COLMAP model."""

import time
import webbrowser
from functools import partial
from pathlib import Path

import click

from dgc_pose.cli.batch import OUT, BatchChoice, echo_each_camera, report, work_through
from dgc_pose.cli.estimate import NO_POSE
from dgc_pose.cli.options import dataclass_options
from dgc_pose.cli.output import shared_text
from dgc_pose.cli.process import progress_bars, to_stderr
from dgc_pose.colmap.options import ReconstructionOptions
from dgc_pose.errors import InputError
from dgc_pose.system.files import write_text


@click.command()
@click.argument("source", metavar="FOLDER")
@OUT
@dataclass_options(ReconstructionOptions, "options")
@dataclass_options(BatchChoice, "choice")
@click.option("--view", is_flag=True, help="Open model.html in the browser.")
def reconstruct(
    source: str, out: Path, options: ReconstructionOptions, choice: BatchChoice, view: bool
) -> int:
    """Reconstruct cameras and points from a folder of photographs.

    FOLDER may also be a video, a list of pairs or a COLMAP database, as for `dgc-pose batch`.

    Writes sparse/ (a COLMAP model; models of further scenes in sparse/1/, ...), database.db,
    points.ply, model.html, summary.json, and batch/ with the batch's files. Exits with 3 if the
    photographs give no model, with 2 if a model stays up to scale in spite of --gps, --scale or
    --marker.
    """
    from dgc_pose.batch.source import BATCH, PAGE, STORE
    from dgc_pose.colmap import reconstruction
    from dgc_pose.colmap.database import NoPairError
    from dgc_pose.viz.model_page import model_page

    names = (*reconstruction.OUTPUTS, PAGE)
    is_there = reconstruction.require_new(out, names, resume=choice.work.resume)
    if is_there and not (out / BATCH / STORE).is_file():
        raise InputError(f"{out} has results, and no batch of this version to continue")
    known = None
    if options.gps or options.scale or options.marker:  # raises before the matching
        images = choice.open(source, out / BATCH)
        paths = {name: images.root / name for name in images.names}
        known = reconstruction.known_metres(paths, options)
    start = time.perf_counter()
    batch = work_through(source, out / BATCH, choice, reconstruction.MIN_IMAGES)
    report(batch)
    matched = time.perf_counter()
    try:
        with progress_bars() as progress:
            show = partial(progress, "images")
            models, shared, metric = reconstruction.reconstruct(batch, out, options, show, known)
    except (NoPairError, reconstruction.NoModelError) as error:
        click.echo(f"no model: {error}")
        return NO_POSE
    seconds = {"match": matched - start, "map": time.perf_counter() - matched}
    rejected = [row.names for row in batch.rows if row.rejected]
    write_text(out / PAGE, model_page(models[0], metric.get("unit", ""), rejected))
    data = reconstruction.write_summary(out, batch, models, shared, metric, seconds)
    click.echo(f"{out / reconstruction.DATABASE}: {shared_text(shared)}")
    click.echo(
        f"{out / reconstruction.MODEL}: {data['registered']} of {data['images']} images, "
        f"{data['points']} points, mean track length {data['mean_track_length']:.2f}, "
        f"reprojection error {data['reprojection_error_px']:.3f} px"
    )
    for number, other in enumerate(models[1:], start=1):
        facts = f"{len(other.poses)} of {data['images']} images, {len(other.points)} points"
        click.echo(f"{out / reconstruction.MODEL / str(number)}: {facts}, in axes of its own")
    for text in metric.pop("warnings", ()):
        to_stderr(f"warning: {text}")
    up_to_scale = metric.pop("not_in_metres", None)
    for fact, value in metric.items():
        click.echo(f"{fact.replace('_', ' ')}: {value}")
    click.echo(f"{out / reconstruction.POINTS}: the points with their colours")
    click.echo(f"{out / PAGE}: cameras with their photographs, and points, for a browser")
    after = " after bundle adjustment" if reconstruction.refines(batch, options) else ""
    cameras = [
        (camera["images"], f"{camera['model']}, f = {camera['focal_px']:.1f} px{after}")
        for camera in data["cameras"]
    ]
    echo_each_camera(cameras, out / reconstruction.SUMMARY)
    for name, pairs in data["not_registered_pairs"].items():
        to_stderr(f"not registered: {name}: {pairs}")
    if view:
        webbrowser.open((out / PAGE).resolve().as_uri())
    if up_to_scale is not None:
        model = out / reconstruction.MODEL
        raise reconstruction.MappingError(f"{model} is up to scale:", *up_to_scale.args)
    return 0
