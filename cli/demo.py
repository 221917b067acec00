"""`dgc-pose demo`: the bundled pair, its estimated pose beside the known pose."""

import shlex

import click
import numpy as np
from click.core import ParameterSource

from dgc_pose.cameras.camera import Camera
from dgc_pose.cameras.pair_list import Pair, rendered_pair
from dgc_pose.cli.dataclass_options import dataclass_options
from dgc_pose.cli.estimate import NO_POSE, Outputs, draw, traced
from dgc_pose.cli.options import CameraChoice
from dgc_pose.cli.output import pose_text, row_lines
from dgc_pose.estimation import EstimationOptions, RelativePose, ScaleSource
from dgc_pose.files.outputs import staged
from dgc_pose.matchers import MatcherOptions
from dgc_pose.metrics import rotation_error_deg, translation_error_deg


@click.command()
@dataclass_options(MatcherOptions, "matcher")
@dataclass_options(EstimationOptions, "estimation")
@dataclass_options(Outputs, "outputs", only=("plot", "plot_width", "plot_dpi"))
def demo(matcher: MatcherOptions, estimation: EstimationOptions, outputs: Outputs) -> int:
    """Estimate the pose of the bundled pair and print it beside the known pose.

    The command that is printed too does the same as one of yours.
    """
    pair = rendered_pair()
    K1, K2 = _numbers(pair.camera1), _numbers(pair.camera2)
    with staged(outputs.plot) as stage:
        choice = CameraChoice(k1=K1, k2=K2)
        trace = traced(pair.path1, pair.path2, choice, matcher, estimation, ScaleSource())
        if outputs.plot is not None:
            draw(trace, stage(outputs.plot), outputs)
    click.echo(f"image 1: {pair.path1}, K {K1}\nimage 2: {pair.path2}, K {K2}\n")
    words = ["dgc-pose", "estimate", str(pair.path1), str(pair.path2), "--K1", K1, "--K2", K2]
    click.echo(f"the same by: {shlex.join([*words, *_chosen(click.get_current_context())])}\n")
    click.echo(pose_text(trace.pose) + "\n")
    if not trace.pose.success:
        return NO_POSE
    click.echo(_beside(trace.pose, pair))
    return 0


def _numbers(camera: Camera) -> str:
    """fx, fy, cx and cy, as --K takes them."""
    return ",".join(f"{value:.15g}" for value in camera.K[(0, 1, 0, 1), (0, 1, 2, 2)])


def _chosen(context: click.Context) -> list[str]:
    """The options of the matching and the estimation that the command line has."""
    words = []
    for option in context.command.params:
        name = option.name or ""
        on_line = context.get_parameter_source(name) == ParameterSource.COMMANDLINE
        if on_line and name.startswith(("matcher__", "estimation__")):
            value = context.params[name]
            flags = option.opts if value is not False else option.secondary_opts
            words += [flags[0]] if isinstance(value, bool) else [flags[0], str(value)]
    return words


def _beside(pose: RelativePose, pair: Pair) -> str:
    """An estimated pose that has R and t and the known pose in two columns, and the errors."""
    assert pose.R is not None and pose.t is not None
    known = row_lines(*pair.R, pair.t / np.linalg.norm(pair.t))
    lines = [f"     {'estimated':{len(known[0])}}   known{' ' * (len(known[0]) - 5)}"]
    for name, left, right in zip("RRRt", row_lines(*pose.R, pose.t), known, strict=True):
        lines.append(f"  {name}  {left}   {right}")
    lines.append(
        f"errors: rotation {rotation_error_deg(pose.R, pair.R):.2f} deg, "
        f"translation direction {translation_error_deg(pose.t, pair.t):.2f} deg"
    )
    return "\n".join(lines)
