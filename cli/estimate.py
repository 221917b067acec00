"""`dgc-pose estimate`: the relative pose of two photographs; `dgc-pose demo`: of bundled pairs."""

from __future__ import annotations

import os
import shlex
import time
from dataclasses import dataclass

import click
import numpy as np

from dgc_pose.cameras.pair_list import bundled_photographs, rendered_pair
from dgc_pose.cli.guard import STDOUT, OutputFile
from dgc_pose.cli.options import CameraChoice, MaskChoice, dataclass_options, output_file
from dgc_pose.cli.output import pose_text, row_lines, write_npz
from dgc_pose.cli.process import name_missing_second, to_stderr
from dgc_pose.errors import ArgumentName, InputError
from dgc_pose.estimation import EstimationOptions
from dgc_pose.estimation.scale import ScaleSource
from dgc_pose.images.image import load_pair
from dgc_pose.matchers import MatcherOptions
from dgc_pose.system.files import save_text, staged

NO_POSE = 3  # exit code if there is no pose


@dataclass(frozen=True)
class Outputs:
    """The files to write."""

    json: str | None = output_file("Write the pose as JSON; - for stdout.", "PATH|-", stdout=True)
    matches: str | None = output_file(
        "Write the matches: points1, points2 (N, 2), confidence and inliers (N), error_px, "
        "key_points, weights, and the names image1 and image2 in the folder that holds both, as "
        "`dgc-pose judge` reads them.",
        "PATH.npz",
    )
    map: str | None = output_file(
        "Write the dense map: map (H, W, 2), for each cell of a grid over image 2 its point in "
        "image 1; grid (H, W, 2), the cells' centres in image 2; matchability (H, W).",
        "PATH.npz",
    )
    plot: str | None = output_file("Draw matches, epipolar lines, warp.", "PATH.png", picture=True)
    ply: str | None = output_file(
        "Write the inliers' points in space, coloured, in metres if t has a length; no points "
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

    Prints cam2_from_cam1, x2 = R x1 + t. The translation is up to scale unless a depth map,
    --baseline or --marker determines its length. Without --K, --K1 and --fov, the focal length is
    estimated, as with --K auto. Points are in pixels of the upright original images. Without a
    pose, prints the reason and exits with 3. If several poses explain the matches equally well,
    prints all of them and exits with 3.
    """
    json_file = None if outputs.json == STDOUT else outputs.json
    with staged(json_file, outputs.matches, outputs.map, outputs.plot, outputs.ply) as stage:
        start = time.perf_counter()
        first, second = load_pair((image1, image2), (masks.mask1, masks.mask2))
        pair = cameras.resolve(first, second)
        from dgc_pose.pose import may_change, solve_pair  # slow to import: only for usable input

        loaded = matcher.load()
        result = solve_pair(first, second, pair, loaded, estimation, scale, start=start)
        pose = result.pose
        data = pose.to_json()
        if json_file is not None:
            save_text(stage(json_file), data)
        if outputs.matches is not None:
            columns = ("points1", "points2", "confidence", "error_px", "key_points")
            arrays = {name: getattr(result.matches, name) for name in columns}
            name1, name2 = _names(image1, image2)
            arrays |= {"inliers": pose.inliers, "image1": name1, "image2": name2}
            arrays |= {"weights": result.matches.weights or ""}
            write_npz(stage(outputs.matches), arrays)
        if outputs.map is not None:
            dense = result.correspondence_map
            if dense is None:
                raise InputError(
                    ArgumentName("map"), f"needs a dense map, and {matcher.weights} has none"
                )
            names = ("map", "grid", "matchability")
            write_npz(stage(outputs.map), {name: getattr(dense, name) for name in names})
        if outputs.plot is not None:
            from dgc_pose.viz import plot_pose, save_figure

            save_figure(plot_pose(result), stage(outputs.plot))
        if outputs.ply is not None:
            from dgc_pose.model import write_points

            points = result.points3d  # in camera 1's axes
            known = np.isfinite(points).all(axis=1)
            write_points(stage(outputs.ply), points[known], result.colours[known])
    if cameras.k is None and cameras.k1 is None and cameras.fov is None:
        name = "K" if cameras.k2 is None else "K1"
        to_stderr(f"{name} is not stated: the focal length is estimated (--{name} auto)")
    if matcher.takes_second and not pose.success and may_change("second", pose, estimation):
        name_missing_second()
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


def _names(*images: str) -> list[str]:
    """The paths of images relative to the folder that holds all of them."""
    paths = [os.path.abspath(image) for image in images]
    folder = os.path.commonpath(map(os.path.dirname, paths))
    return [os.path.relpath(path, folder) for path in paths]


@click.command()
@click.option(
    "--plot",
    type=OutputFile(picture=True),
    metavar="PATH.png",
    help="Draw the photographs' matches, epipolar lines, warp.",
)
def demo(plot: str | None) -> int:
    """Estimate the poses of the two pairs that come with the package.

    The first pair was taken by a phone of unknown K; --plot draws it. The second pair is rendered,
    and its known pose is printed too. You can run the printed commands yourself.
    """
    pair = rendered_pair()
    Ks = [camera.K[(0, 1, 0, 1), (0, 1, 2, 2)].tolist() for camera in (pair.camera1, pair.camera2)]
    K1, K2 = (",".join(f"{value:.15g}" for value in K) for K in Ks)
    drawn = [] if plot is None else ["--plot", plot]
    statuses = []
    for heading, *words in (
        ("two photographs by a phone, K not known:", *bundled_photographs(), "--K", "auto", *drawn),
        ("\na rendered pair:", pair.path1, pair.path2, "--K1", K1, "--K2", K2),
    ):
        arguments = [*map(str, words)]
        click.echo(f"{heading}\n\n{shlex.join(['dgc-pose', 'estimate', *arguments])}\n")
        with estimate.make_context("estimate", arguments) as context:
            statuses.append(estimate.invoke(context))
    click.echo("the known pose:")
    for name, line in zip("RRRt", row_lines(*pair.R, pair.t / np.linalg.norm(pair.t)), strict=True):
        click.echo(f"  {name}  {line}")
    return max(statuses)
