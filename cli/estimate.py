"""`dgc-pose estimate`: the relative pose of two photographs."""

from __future__ import annotations

import time
from dataclasses import dataclass, replace
from pathlib import Path
from typing import TYPE_CHECKING, Any

import click
import numpy as np

from dgc_pose.cli.dataclass_options import dataclass_options
from dgc_pose.cli.guard import STDOUT, OutputFile
from dgc_pose.cli.options import CameraChoice, MaskChoice
from dgc_pose.cli.output import matches_arrays, pose_text, write_npz
from dgc_pose.cli.process import say
from dgc_pose.estimation import EstimationOptions
from dgc_pose.estimation.scale import ScaleSource, with_length
from dgc_pose.files.outputs import save_text, staged
from dgc_pose.images.image import load_image
from dgc_pose.images.mask import masked
from dgc_pose.matchers import MatcherOptions
from dgc_pose.system.options import option

if TYPE_CHECKING:
    from dgc_pose.trace import Trace

NO_POSE = 3  # exit code if there is no pose


def file_option(help: str, metavar: str, **kind: bool) -> Any:
    return option(None, help, metavar=metavar, type=OutputFile(**kind))


def _number(default: float, help: str, least: float, most: float) -> Any:
    return option(default, help, metavar="N", section="advanced", min=least, max=most)


@dataclass(frozen=True)
class Outputs:
    """The files to write."""

    json: str | None = file_option("Write the pose as JSON; - for stdout.", "PATH|-", stdout=True)
    matches: str | None = file_option("Write the matches and which are inliers.", "PATH.npz")
    plot: str | None = file_option("Draw matches, epipolar lines, warp.", "PATH.png", picture=True)
    plot_dpi: int = _number(200, "Pixels to an inch of --plot.", 50, 600)
    ply: str | None = file_option(
        "Write the inliers' points in space, coloured, in metres if t has a length; nothing "
        "without a pose.",
        "PATH.ply",
    )


@click.command()
@click.argument("image1", metavar="IMG1", type=click.Path())
@click.argument("image2", metavar="IMG2", type=click.Path())
@dataclass_options(MaskChoice, "masks")
@dataclass_options(CameraChoice, "cameras")
@dataclass_options(MatcherOptions, "matcher")
@dataclass_options(EstimationOptions, "estimation")
@dataclass_options(ScaleSource, "scale")
@dataclass_options(Outputs, "outputs")
def estimate(
    image1: str,
    image2: str,
    masks: MaskChoice,
    cameras: CameraChoice,
    matcher: MatcherOptions,
    estimation: EstimationOptions,
    scale: ScaleSource,
    outputs: Outputs,
) -> int:
    """Estimate the relative pose of two photographs.

    Prints cam2_from_cam1, x2 = R x1 + t, the translation up to scale unless a depth map, --baseline
    or --distance states its length. Without --K, --K1 and --fov it is as with --K auto. Exits with
    3 and the reason if there is no pose, and with all of them if several explain the matches alike.
    """
    json_file = None if outputs.json == STDOUT else outputs.json
    with staged(json_file, outputs.matches, outputs.plot, outputs.ply) as stage:
        trace = traced(image1, image2, cameras, matcher, estimation, scale, masks)
        pose, data = trace.pose, trace.pose.to_json()
        if json_file is not None:
            save_text(stage(json_file), data)
        if outputs.matches is not None:
            arrays = matches_arrays(trace.matches) | {"inliers": pose.inliers}
            write_npz(stage(outputs.matches), arrays)
        if outputs.plot is not None:
            draw(trace, stage(outputs.plot), outputs)
        if outputs.ply is not None and pose.success:
            from dgc_pose.model import write_points

            points = trace.points3d  # in camera 1's axes
            known = np.isfinite(points).all(axis=1)
            write_points(stage(outputs.ply), points[known], trace.colours[known], outputs.ply)
    if cameras.k is None and cameras.k1 is None and cameras.fov is None:
        name = "K" if cameras.k2 is None else "K1"
        say(f"{name} is not stated: the focal length is estimated (--{name} auto)")
    if outputs.json != STDOUT:
        click.echo(pose_text(pose, (trace.prior1, trace.prior2)))
        for number, image in enumerate((trace.image1, trace.image2), start=1):
            if (turn := image.exif.orientation) != 1:
                click.echo(f"image {number}: EXIF orientation {turn} is applied to it")
    else:
        click.echo(data, nl=False)
        if not pose.success:
            click.echo(f"no pose: {pose.reason}", err=True)
    return 0 if pose.success else NO_POSE


def traced(
    path1: str | Path,
    path2: str | Path,
    cameras: CameraChoice,
    matcher: MatcherOptions,
    estimation: EstimationOptions,
    scale: ScaleSource,
    masks: MaskChoice = MaskChoice(),  # noqa: B008, it is frozen
) -> Trace:
    """The trace of the pose of two images. In its `seconds`, `load` is the time for images and
    weights."""
    start = time.perf_counter()
    image1 = masked(load_image(path1), masks.mask1, "mask1")
    image2 = masked(load_image(path2), masks.mask2, "mask2")
    camera1, camera2 = cameras.resolve(image1, image2)
    maps = scale.maps((image1, image2))
    read_seconds = time.perf_counter() - start
    from dgc_pose.pose import pose_of_pair  # heavy; unusable input is refused without it
    from dgc_pose.trace import Trace

    start = time.perf_counter()
    loaded = matcher.load()
    seconds = read_seconds + time.perf_counter() - start
    search = loaded.search(image1, image2)
    pose = pose_of_pair(search, camera1, camera2, estimation)
    pose = with_length(pose, search.last.matches, scale, maps)
    pose = replace(pose, seconds={"load": seconds, **pose.seconds})
    return Trace.of(search, camera1, camera2, pose)


def draw(trace: Trace, file: Path, outputs: Outputs) -> None:
    """Draw the figure of a trace into a file."""
    from dgc_pose.viz import plot_pose, save_figure

    save_figure(plot_pose(trace), file, outputs.plot_dpi)
