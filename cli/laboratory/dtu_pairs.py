"""`dgc-pose dtu-pairs`: a pair list from DTU's calibration."""

from typing import get_args

import click

from dgc_pose.benchmarks.dtu.dataset import Light, open_dataset
from dgc_pose.benchmarks.dtu.view_pairs import ViewPairOptions, draw, find_view_pairs, listed_pair
from dgc_pose.cameras.pair_list import write_pairs
from dgc_pose.cli.dataclass_options import dataclass_options
from dgc_pose.cli.guard import OutputFile
from dgc_pose.errors import InputError
from dgc_pose.files.outputs import staged


@click.command()
@click.argument("root", metavar="ROOT")
@click.argument("out", metavar="OUT.txt", type=OutputFile())
@click.option("--scan", type=int, help="Number of the scan; default: all that are there.")
@click.option(
    "--light", type=click.Choice(get_args(Light)), default="3", help="Number of the light, or max."
)
@dataclass_options(ViewPairOptions, "options")
def dtu_pairs(
    root: str, out: str, scan: int | None, light: Light, options: ViewPairOptions
) -> None:
    """Draw pairs of views of DTU at random, spread over the scans and the rotations.

    ROOT holds DTU as its authors ship it. OUT.txt is a list in
    SuperGlue's format with paths relative to ROOT: give `bench-pairs` that ROOT by --root.
    """
    folder, scenes = open_dataset(root, scan, light)
    candidates = find_view_pairs(scenes, options)
    if not candidates:
        raise InputError(f"{root}: no two views of {len(scenes)} scans fit these limits")
    drawn = draw(candidates, options)
    with staged(out) as stage:
        write_pairs(stage(out), [listed_pair(folder, pair) for pair in drawn])
    rotations = sorted(pair.rotation_deg for pair in drawn)
    click.echo(
        f"{out}: {len(drawn)} pairs of {len(candidates)} candidates, "
        f"rotations {rotations[0]:.1f} to {rotations[-1]:.1f} deg, "
        f"{sum(len(scene.views) for scene in scenes)} views, "
        f"{sum(scene.missing for scene in scenes)} left out without an image or a calibration"
    )
    if len(drawn) < options.pairs:
        click.echo(f"warning: {options.pairs} pairs were asked for; there are no more", err=True)
