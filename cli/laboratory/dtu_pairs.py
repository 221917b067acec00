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

LIGHT_HELP = "Number of the light, or max."


@click.command()
@click.argument("root", metavar="ROOT")
@click.argument("out", metavar="OUT.txt", type=OutputFile())
@click.option("--scan", type=click.IntRange(0, 10**6), required=True, help="Number of the scan.")
@click.option("--light", type=click.Choice(get_args(Light)), default="3", help=LIGHT_HELP)
@dataclass_options(ViewPairOptions, "options")
def dtu_pairs(root: str, out: str, scan: int, light: Light, options: ViewPairOptions) -> None:
    """Draw pairs of views of one DTU scan at random, spread over the rotations.

    ROOT holds DTU as its authors ship it. OUT.txt is a list in
    SuperGlue's format with paths relative to ROOT: give `bench-pairs` that ROOT by --root.
    """
    dataset = open_dataset(root, scenes=[scan], light=light)
    scene = dataset.scene(scan)
    candidates = find_view_pairs(dataset, options)
    if not candidates:
        raise InputError(f"{root}: no two of {len(scene.views)} views fit these limits")
    drawn = draw(candidates, options)
    with staged(out) as stage:
        write_pairs(stage(out), [listed_pair(dataset, pair) for pair in drawn])
    rotations = sorted(pair.rotation_deg for pair in drawn)
    click.echo(
        f"{out}: {len(drawn)} pairs of {len(candidates)} candidates, "
        f"rotations {rotations[0]:.1f} to {rotations[-1]:.1f} deg, {len(scene.views)} views, "
        f"{scene.missing} left out without an image or a calibration"
    )
    if len(drawn) < options.pairs:
        click.echo(f"warning: {options.pairs} pairs were asked for; there are no more", err=True)
