"""`dgc-pose estimate`: the relative pose of two photographs."""

from __future__ import annotations

import click

from dgc_pose.cli.options import (
    CameraChoice,
    MatcherChoice,
    camera_options,
    estimator_options,
    matcher_options,
)
from dgc_pose.cli.output import json_text, matches_arrays, pose_data, pose_text, write_npz
from dgc_pose.cli.pipeline import NO_POSE, check_picture, draw, run_pipeline
from dgc_pose.estimation import EstimationOptions, RelativePose
from dgc_pose.files import staged

STDOUT = "-"


@click.command()
@click.argument("image1", metavar="IMG1")
@click.argument("image2", metavar="IMG2")
@camera_options
@matcher_options
@estimator_options
@click.option("--json", "json_path", metavar="PATH|-", help="Write the pose as JSON; - for stdout.")
@click.option(
    "--matches", "matches_path", metavar="PATH.npz", help="Write the matches and which are inliers."
)
@click.option(
    "--plot", "plot_path", metavar="PATH.png", help="Draw inliers, epipolar lines and the warp."
)
def estimate(
    image1: str,
    image2: str,
    cameras: CameraChoice,
    matcher: MatcherChoice,
    estimation: EstimationOptions,
    json_path: str | None,
    matches_path: str | None,
    plot_path: str | None,
) -> int:
    """Estimate the relative pose of two photographs.

    Prints cam2_from_cam1, x2 = R x1 + t, the translation up to scale. Exits with 3 and the reason
    if there is no pose.
    """
    check_picture(plot_path)
    json_file = None if json_path == STDOUT else json_path
    with staged(json_file, matches_path, plot_path) as stage:
        trace = run_pipeline(image1, image2, cameras.resolve, matcher, estimation)
        data = json_text(pose_data(trace.pose))
        if json_file is not None:
            stage(json_file).write_text(data, encoding="utf-8")
        if matches_path is not None:
            arrays = matches_arrays(trace.matches) | {"inliers": trace.pose.inliers}
            write_npz(stage(matches_path), arrays)
        if plot_path is not None:
            draw(trace, stage(plot_path), plot_path)
    _print(trace.pose, data if json_path == STDOUT else None)
    return 0 if trace.pose.success else NO_POSE


def _print(pose: RelativePose, data: str | None) -> None:
    """The pose as text; or its JSON alone on stdout, and on stderr the reason for no pose."""
    if data is None:
        click.echo(pose_text(pose))
        return
    click.echo(data, nl=False)
    if not pose.success:
        click.echo(f"no pose: {pose.reason}", err=True)
