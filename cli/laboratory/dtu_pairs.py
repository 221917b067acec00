"""`dgc-pose dtu-pairs`: a pair list from DTU's calibration."""

from dataclasses import dataclass
from pathlib import Path

import click

from dgc_pose.benchmarks.dtu.dataset import Light, open_dataset
from dgc_pose.benchmarks.dtu.view_pairs import ViewPairOptions, draw, find_view_pairs, listed_pair
from dgc_pose.cameras.pair_list import Pair, write_pairs
from dgc_pose.cli.guard import OutputFile
from dgc_pose.cli.options import dataclass_options
from dgc_pose.errors import InputError
from dgc_pose.system.files import staged
from dgc_pose.system.options import option


@dataclass(frozen=True)
class DtuChoice:
    """Which scans of DTU, and which of their images."""

    scan: int | None = option(None, "Number of the scan; default: all that are there.")
    light: Light = option("3", "Number of the light, or max.")


@click.command()
@click.argument("root", metavar="ROOT")
@click.argument("out", metavar="OUT.txt", type=OutputFile())
@dataclass_options(DtuChoice, "choice")
@dataclass_options(ViewPairOptions, "options")
def dtu_pairs(root: str, out: str, choice: DtuChoice, options: ViewPairOptions) -> None:
    """Draw pairs of views of DTU at random, spread over the scans and the rotations.

    ROOT holds DTU as its authors ship it. OUT.txt is a list in
    SuperGlue's format with paths relative to ROOT: give `bench-pairs` that ROOT by --root.
    """
    with staged(out) as stage:
        write_pairs(stage(out), drawn_pairs(root, choice, options, out))


def drawn_pairs(
    root: str, choice: DtuChoice, options: ViewPairOptions, out: str | Path
) -> list[Pair]:
    """The pairs drawn, and a line on them. out: their list."""
    folder, scenes = open_dataset(root, choice.scan, choice.light)
    candidates = find_view_pairs(scenes, options)
    if not candidates:
        raise InputError(f"{root}: no two views of {len(scenes)} scans fit these limits")
    drawn = draw(candidates, options)
    rotations = sorted(pair.rotation_deg for pair in drawn)
    click.echo(
        f"{out}: {len(drawn)} pairs of {len(candidates)} candidates, "
        f"rotations {rotations[0]:.1f} to {rotations[-1]:.1f} deg, "
        f"{sum(len(scene.views) for scene in scenes)} views, "
        f"{sum(scene.missing for scene in scenes)} left out without an image or a calibration"
    )
    if len(drawn) < options.pairs:
        click.echo(f"warning: {options.pairs} pairs were asked for; there are no more", err=True)
    return [listed_pair(folder, pair) for pair in drawn]
