"""`dgc-pose dtu-pairs`: a pair list from DTU's calibration."""

from __future__ import annotations

from typing import get_args

import click

from dgc_pose.benchmarks.dtu.dataset import Layout, open_dataset
from dgc_pose.benchmarks.dtu.scene import LIGHTS
from dgc_pose.benchmarks.dtu.view_pairs import (
    ViewPairOptions,
    draw,
    find_view_pairs,
    listed_pair,
)
from dgc_pose.benchmarks.pair_list import write_pairs
from dgc_pose.errors import InputError
from dgc_pose.files import staged

DEFAULTS = ViewPairOptions()


@click.command()
@click.argument("root", metavar="ROOT")
@click.argument("out", metavar="OUT.txt")
@click.option("--scan", type=int, required=True, help="Number of the scan.")
@click.option(
    "--layout",
    type=click.Choice(get_args(Layout)),
    help="Of the files in ROOT; by default found by looking.",
)
@click.option(
    "--light", type=click.Choice(LIGHTS), default="3", show_default=True, help="Which light."
)
@click.option("--pairs", default=DEFAULTS.pairs, show_default=True, help="How many pairs to draw.")
@click.option(
    "--min-rotation",
    default=DEFAULTS.min_rotation,
    show_default=True,
    help="Smallest relative rotation, degrees.",
)
@click.option(
    "--max-rotation",
    default=DEFAULTS.max_rotation,
    show_default=True,
    help="Largest relative rotation, degrees.",
)
@click.option(
    "--min-overlap",
    default=DEFAULTS.min_overlap,
    show_default=True,
    help="Least share of the space at DTU's depths that both views see.",
)
@click.option(
    "--seed", default=DEFAULTS.seed, show_default=True, help="The same seed, the same list."
)
def dtu_pairs(
    root: str,
    out: str,
    scan: int,
    layout: Layout | None,
    light: str,
    pairs: int,
    min_rotation: float,
    max_rotation: float,
    min_overlap: float,
    seed: int,
) -> None:
    """Draw pairs of views of one DTU scan at random, spread over the rotations.

    ROOT holds DTU as DTU ships it, or as it was prepared for MVSNet or NeuS. OUT.txt is a list in
    SuperGlue's format with paths relative to ROOT: give `bench-pairs` that ROOT by --root.
    """
    options = ViewPairOptions(pairs, min_rotation, max_rotation, min_overlap, seed=seed)
    dataset = open_dataset(root, layout=layout, scenes=[scan], light=light)
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
        f"{scene.absent} left out without an image or a calibration"
    )
    if len(drawn) < pairs:
        click.echo(f"warning: {pairs} pairs were asked for; there are no more", err=True)
