"""`dgc-pose demo`: two photographs by a phone, and a rendered pair beside its known pose."""

import json
import shlex
import tempfile
from pathlib import Path

import click
import numpy as np

from dgc_pose.cameras.pair_list import bundled_photographs, rendered_pair
from dgc_pose.cli.estimate import NO_POSE, estimate
from dgc_pose.cli.guard import OutputFile
from dgc_pose.cli.output import row_lines
from dgc_pose.metrics import rotation_error_deg, translation_error_deg


@click.command()
@click.option(
    "--plot",
    type=OutputFile(picture=True),
    metavar="PATH.png",
    help="Draw the photographs' matches, epipolar lines, warp.",
)
def demo(plot: str | None) -> int:
    """Estimate the poses of the two pairs that come with the package.

    The first are photographs by a phone, whose K is not known; --plot draws them. The second is
    rendered: its estimated pose stands beside the known pose. The commands that are printed too do
    the same as commands of yours.
    """
    drawn = [] if plot is None else ["--plot", plot]
    words = [*map(str, bundled_photographs()), "--K", "auto", *drawn]
    status = _estimated("two photographs by a phone, K not known:\n", *words)
    pair = rendered_pair()
    Ks = [camera.K[(0, 1, 0, 1), (0, 1, 2, 2)].tolist() for camera in (pair.camera1, pair.camera2)]
    K1, K2 = (",".join(f"{value:.15g}" for value in K) for K in Ks)
    words = [str(pair.path1), str(pair.path2), "--K1", K1, "--K2", K2]
    with tempfile.TemporaryDirectory(prefix="dgc-pose.") as folder:
        file = Path(folder, "pose.json")
        status = _estimated("\na rendered pair:\n", *words, file=file) or status
        data = json.loads(file.read_text(encoding="utf-8"))
    if status:
        return NO_POSE
    R, t = np.array(data["R"]), np.array(data["t"])
    known = row_lines(*pair.R, pair.t / np.linalg.norm(pair.t))
    click.echo(f"\n     {'estimated':{len(known[0])}}   known{' ' * (len(known[0]) - 5)}")
    for name, left, right in zip("RRRt", row_lines(*R, t), known, strict=True):
        click.echo(f"  {name}  {left}   {right}")
    click.echo(
        f"errors: rotation {rotation_error_deg(R, pair.R):.2f} deg, "
        f"translation direction {translation_error_deg(t, pair.t):.2f} deg"
    )
    return 0


def _estimated(heading: str, *words: str, file: Path | None = None) -> int:
    """Run `dgc-pose estimate WORDS` below a heading and that command. file: for the pose as JSON.

    Returns the exit code."""
    click.echo(f"{heading}\n{shlex.join(['dgc-pose', 'estimate', *words])}\n")
    stored = [] if file is None else ["--json", str(file)]
    with estimate.make_context("estimate", [*words, *stored]) as context:
        status: int = estimate.invoke(context)
    return status
