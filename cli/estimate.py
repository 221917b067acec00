"""`dgc-pose estimate`: the relative pose of two photographs."""

from __future__ import annotations

from dataclasses import dataclass

import click

from dgc_pose.cli.dataclass_options import dataclass_options
from dgc_pose.cli.guard import STDOUT, OutputFile
from dgc_pose.cli.options import CameraChoice
from dgc_pose.cli.output import matches_arrays, pose_data, pose_text, write_npz
from dgc_pose.cli.pipeline import NO_POSE, check_picture, draw, run_pipeline
from dgc_pose.estimation import EstimationOptions
from dgc_pose.files.json_files import json_text
from dgc_pose.files.outputs import save_text, staged
from dgc_pose.matchers import MatcherOptions
from dgc_pose.system.options import option


@dataclass(frozen=True)
class Outputs:
    """The files to write."""

    json: str | None = option(
        None,
        "Write the pose as JSON; - for stdout.",
        metavar="PATH|-",
        type=OutputFile(stdout=True),
    )
    matches: str | None = option(
        None,
        "Write the matches and which are inliers.",
        metavar="PATH.npz",
        type=OutputFile(),
    )
    plot: str | None = option(
        None,
        "Draw inliers, epipolar lines and the warp.",
        metavar="PATH.png",
        type=OutputFile(),
    )


@click.command()
@click.argument("image1", metavar="IMG1", type=click.Path())
@click.argument("image2", metavar="IMG2", type=click.Path())
@dataclass_options(CameraChoice, "cameras")
@dataclass_options(MatcherOptions, "matcher")
@dataclass_options(EstimationOptions, "estimation")
@dataclass_options(Outputs, "outputs")
def estimate(
    image1: str,
    image2: str,
    cameras: CameraChoice,
    matcher: MatcherOptions,
    estimation: EstimationOptions,
    outputs: Outputs,
) -> int:
    """Estimate the relative pose of two photographs.

    Prints cam2_from_cam1, x2 = R x1 + t, the translation up to scale. Exits with 3 and the reason
    if there is no pose.
    """
    check_picture(outputs.plot)
    json_file = None if outputs.json == STDOUT else outputs.json
    with staged(json_file, outputs.matches, outputs.plot) as stage:
        trace = run_pipeline(image1, image2, cameras.resolve, matcher, estimation)
        pose, data = trace.pose, json_text(pose_data(trace.pose))
        if json_file is not None:
            save_text(stage(json_file), data)
        if outputs.matches is not None:
            arrays = matches_arrays(trace.matches) | {"inliers": pose.inliers}
            write_npz(stage(outputs.matches), arrays)
        draw(trace, stage, outputs.plot)
    if outputs.json != STDOUT:
        click.echo(pose_text(pose))
    else:
        click.echo(data, nl=False)
        if not pose.success:
            click.echo(f"no pose: {pose.reason}", err=True)
    return 0 if pose.success else NO_POSE
