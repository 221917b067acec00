"""`dgc-pose demo`: the bundled pair, its estimated pose beside the known pose."""

import click
import numpy as np

from dgc_pose.cameras.pair_list import Pair, bundled_pair
from dgc_pose.cli.dataclass_options import dataclass_options
from dgc_pose.cli.estimate import NO_POSE, Outputs, check_picture, draw, run_pipeline
from dgc_pose.cli.output import matrix_lines, pose_text, vector_line
from dgc_pose.estimation import EstimationOptions, RelativePose
from dgc_pose.files.outputs import staged
from dgc_pose.matchers import MatcherOptions
from dgc_pose.metrics import rotation_error_deg, translation_error_deg


@click.command()
@dataclass_options(MatcherOptions, "matcher")
@dataclass_options(EstimationOptions, "estimation")
@dataclass_options(Outputs, "outputs", only=("plot",))
def demo(matcher: MatcherOptions, estimation: EstimationOptions, outputs: Outputs) -> int:
    """Estimate the pose of the bundled pair and print it beside the known pose."""
    check_picture(outputs.plot)
    pair = bundled_pair()
    with staged(outputs.plot) as stage:
        trace = run_pipeline(
            pair.path1, pair.path2, lambda *_: (pair.camera1, pair.camera2), matcher, estimation
        )
        draw(trace, stage, outputs.plot)
    pose = trace.pose
    click.echo(f"image 1: {pair.path1}\nimage 2: {pair.path2}\n")
    click.echo(pose_text(pose) + "\n")
    if not pose.success:
        return NO_POSE
    click.echo(_beside(pose, pair))
    return 0


def _beside(pose: RelativePose, pair: Pair) -> str:
    """An estimated pose that has R and t and the known pose in two columns, and the errors."""
    assert pose.R is not None and pose.t is not None
    known = matrix_lines(pair.R) + [vector_line(pair.t / np.linalg.norm(pair.t))]
    estimated = matrix_lines(pose.R) + [vector_line(pose.t)]
    width = len(known[0])
    lines = [f"     {'estimated':{width}}   {'known':{width}}"]
    for name, left, right in zip("RRRt", estimated, known, strict=True):
        lines.append(f"  {name}  {left}   {right}")
    lines.append(
        f"errors: rotation {rotation_error_deg(pose.R, pair.R):.2f} deg, "
        f"translation direction {translation_error_deg(pose.t, pair.t):.2f} deg"
    )
    return "\n".join(lines)
