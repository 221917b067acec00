"""`dgc-pose match`: the dense matches of two photographs, no K needed."""

from __future__ import annotations

import click

from dgc_pose.cli.options import MatcherChoice, matcher_options
from dgc_pose.cli.output import matches_arrays, write_npz
from dgc_pose.files import staged
from dgc_pose.image import load_image


@click.command()
@click.argument("image1", metavar="IMG1")
@click.argument("image2", metavar="IMG2")
@click.option("--out", required=True, metavar="PATH.npz", help="Where to write the matches.")
@matcher_options
def match(image1: str, image2: str, out: str, network: MatcherChoice) -> None:
    """Match two photographs and write the dense map and the matches taken from it.

    The file holds `map` (H, W, 2), for each cell of a grid over image 2 the place in image 1;
    `grid` (H, W, 2), the places of the cells in image 2; `matchability` (H, W); and `points1`,
    `points2` (N, 2) and `confidence` (N), the matches kept, refined as --refine says.
    All places are pixels of the original images.
    """
    from dgc_pose.pose import match_images  # loads torch

    with staged(out) as stage:
        first, second = load_image(image1), load_image(image2)
        correspondences, matches = match_images(network.load(), first, second)
        assert correspondences is not None  # the network makes one, refined or not
        dense = {
            "map": correspondences.map,
            "grid": correspondences.grid,
            "matchability": correspondences.matchability,
        }
        write_npz(stage(out), dense | matches_arrays(matches))
    for warning in first.warnings + second.warnings:
        click.echo(f"warning: {warning}", err=True)
    height, width = correspondences.matchability.shape
    click.echo(f"{out}: {len(matches)} matches of {height * width} cells")
