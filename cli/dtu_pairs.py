"""`dgc-pose dtu-pairs`: a pair list from DTU's calibration."""

from __future__ import annotations

import click

from dgc_pose.benchmarks.dtu.pairs import (
    PairOptions,
    draw,
    find_candidates,
    make_pairs,
    open_scan,
)
from dgc_pose.benchmarks.pair_list import write_pairs
from dgc_pose.cli.staging import staged
from dgc_pose.errors import InputError

DEFAULTS = PairOptions()


@click.command()
@click.argument("root", metavar="ROOT")
@click.argument("out", metavar="OUT.txt")
@click.option("--scan", type=int, required=True, help="Number of the scan.")
@click.option("--light", default=3, show_default=True, help="Number of the light, 0 to 6.")
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
    light: int,
    pairs: int,
    min_rotation: float,
    max_rotation: float,
    min_overlap: float,
    seed: int,
) -> None:
    """Draw pairs of views of one DTU scan at random, spread over the rotations.

    ROOT holds Calibration/cal18 and Rectified/scanN as DTU ships them. OUT.txt is a list in
    SuperGlue's format with paths relative to ROOT: give `bench-pairs` that ROOT by --root.
    """
    options = PairOptions(pairs, min_rotation, max_rotation, min_overlap, seed=seed)
    found = open_scan(root, scan, light)
    candidates = find_candidates(found.views, options)
    if not candidates:
        raise InputError(f"{root}: no two of {len(found.views)} views fit these limits")
    drawn = draw(candidates, options)
    with staged(out) as stage:
        write_pairs(stage(out), make_pairs(found, drawn))
    rotations = sorted(candidate.rotation_deg for candidate in drawn)
    click.echo(
        f"{out}: {len(drawn)} pairs of {len(candidates)} candidates, "
        f"rotations {rotations[0]:.1f} to {rotations[-1]:.1f} deg, {len(found.views)} views, "
        f"{found.absent} left out for want of an image or a calibration"
    )
    if len(drawn) < pairs:
        click.echo(f"warning: {pairs} pairs were asked for; there are no more", err=True)
