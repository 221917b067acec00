"""`dgc-pose demo`: two photographs by a phone, and a rendered pair beside its known pose."""

from __future__ import annotations

import shlex
from pathlib import Path
from typing import TYPE_CHECKING

import click
import numpy as np
from click.core import ParameterSource

from dgc_pose.cameras.camera import Camera
from dgc_pose.cameras.pair_list import Pair, bundled_photographs, rendered_pair
from dgc_pose.cli.dataclass_options import dataclass_options
from dgc_pose.cli.estimate import NO_POSE, Outputs, draw, traced
from dgc_pose.cli.options import CameraChoice
from dgc_pose.cli.output import pose_text, row_lines
from dgc_pose.estimation import EstimationOptions, RelativePose, ScaleSource
from dgc_pose.files.outputs import staged
from dgc_pose.matchers import MatcherOptions
from dgc_pose.metrics import rotation_error_deg, translation_error_deg

if TYPE_CHECKING:
    from dgc_pose.trace import Trace


@click.command()
@dataclass_options(MatcherOptions, "matcher")
@dataclass_options(EstimationOptions, "estimation")
@dataclass_options(Outputs, "outputs", only=("plot", "plot_dpi"))
def demo(matcher: MatcherOptions, estimation: EstimationOptions, outputs: Outputs) -> int:
    """Estimate the poses of the two pairs that come with the package.

    The first are photographs by a phone, whose K is not known; --plot draws them. The second is
    rendered: its estimated pose stands beside the known pose. The commands that are printed too do
    the same as commands of yours.
    """
    pair = rendered_pair()
    K1, K2 = _numbers(pair.camera1), _numbers(pair.camera2)
    with staged(outputs.plot) as stage:
        heading, cameras = "two photographs by a phone, K not known:\n", CameraChoice(k="auto")
        photographs = _shown(heading, bundled_photographs(), cameras, matcher, estimation)
        if outputs.plot is not None:
            draw(photographs, stage(outputs.plot), outputs)
    heading, cameras = "\na rendered pair:\n", CameraChoice(k1=K1, k2=K2)
    rendered = _shown(heading, (pair.path1, pair.path2), cameras, matcher, estimation)
    if not (photographs.pose.success and rendered.pose.success):
        return NO_POSE
    click.echo("\n" + _beside(rendered.pose, pair))
    return 0


def _shown(
    heading: str,
    paths: tuple[Path, Path],
    cameras: CameraChoice,
    matcher: MatcherOptions,
    estimation: EstimationOptions,
) -> Trace:
    """The trace of a pair, printed below a heading and the command that does the same."""
    trace = traced(*paths, cameras, matcher, estimation, ScaleSource())
    Ks = {"--K": cameras.k, "--K1": cameras.k1, "--K2": cameras.k2}
    words = [word for flag, K in Ks.items() if K is not None for word in (flag, K)]
    words = ["dgc-pose", "estimate", *map(str, paths), *words]
    click.echo(heading)
    click.echo(shlex.join([*words, *_chosen(click.get_current_context())]) + "\n")
    click.echo(pose_text(trace.pose, (trace.prior1, trace.prior2)))
    return trace


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
    """The estimated and the known pose in two columns, and the errors."""
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
