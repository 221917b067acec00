"""`dgc-pose estimate`: the relative pose of two photographs."""

from __future__ import annotations

import time
from dataclasses import dataclass

import click
import numpy as np

from dgc_pose.cli.dataclass_options import dataclass_options
from dgc_pose.cli.guard import STDOUT
from dgc_pose.cli.options import CameraChoice, MaskChoice, output_file
from dgc_pose.cli.output import matches_arrays, pose_text, write_npz
from dgc_pose.cli.process import say
from dgc_pose.estimation import EstimationOptions
from dgc_pose.estimation.scale import ScaleSource
from dgc_pose.files.outputs import save_text, staged
from dgc_pose.images.mask import load_pair
from dgc_pose.matchers import MatcherOptions

NO_POSE = 3  # exit code if there is no pose


@dataclass(frozen=True)
class Outputs:
    """The files to write."""

    json: str | None = output_file("Write the pose as JSON; - for stdout.", "PATH|-", stdout=True)
    matches: str | None = output_file("Write the matches and which are inliers.", "PATH.npz")
    plot: str | None = output_file("Draw matches, epipolar lines, warp.", "PATH.png", picture=True)
    ply: str | None = output_file(
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

    Prints cam2_from_cam1, x2 = R x1 + t, the translation up to scale unless a depth map,
    --baseline, --distance or --marker states its length. Without --K, --K1 and --fov it is as with
    --K auto. Exits with 3 and the reason if there is no pose, and with all of them if several
    explain the matches alike.
    """
    json_file = None if outputs.json == STDOUT else outputs.json
    with staged(json_file, outputs.matches, outputs.plot, outputs.ply) as stage:
        start = time.perf_counter()
        first, second = load_pair((image1, image2), (masks.mask1, masks.mask2))
        pair = cameras.resolve(first, second)
        from dgc_pose.pose import solve_pair  # heavy; unusable input is refused without it

        loaded = matcher.load()
        result = solve_pair(first, second, pair, loaded, estimation, scale, start=start)
        pose = result.pose
        data = pose.to_json()
        if json_file is not None:
            save_text(stage(json_file), data)
        if outputs.matches is not None:
            arrays = matches_arrays(result.matches) | {"inliers": pose.inliers}
            write_npz(stage(outputs.matches), arrays)
        if outputs.plot is not None:
            from dgc_pose.viz import plot_pose, save_figure

            save_figure(plot_pose(result), stage(outputs.plot))
        if outputs.ply is not None and pose.success:
            from dgc_pose.model import write_points

            points = result.points3d  # in camera 1's axes
            known = np.isfinite(points).all(axis=1)
            write_points(stage(outputs.ply), points[known], result.colours[known])
    if cameras.k is None and cameras.k1 is None and cameras.fov is None:
        name = "K" if cameras.k2 is None else "K1"
        say(f"{name} is not stated: the focal length is estimated (--{name} auto)")
    if outputs.json != STDOUT:
        click.echo(pose_text(pose, (result.prior1, result.prior2)))
        for number, image in enumerate((result.image1, result.image2), start=1):
            if (turn := image.exif.orientation) != 1:
                click.echo(f"image {number}: EXIF orientation {turn} is applied to it")
    else:
        click.echo(data, nl=False)
        if not pose.success:
            click.echo(f"no pose: {pose.reason}", err=True)
    return 0 if pose.success else NO_POSE
