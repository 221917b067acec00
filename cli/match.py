"""`dgc-pose match`: the dense matches of two photographs, no K needed."""

import click

from dgc_pose.cli.dataclass_options import dataclass_options
from dgc_pose.cli.guard import OutputFile
from dgc_pose.cli.options import MaskChoice
from dgc_pose.cli.output import matches_arrays, write_npz
from dgc_pose.cli.process import say
from dgc_pose.errors import InputError
from dgc_pose.files.outputs import staged
from dgc_pose.images.image import load_image
from dgc_pose.images.maps import masked
from dgc_pose.matchers import MatcherOptions


@click.command()
@click.argument("image1", metavar="IMG1", type=click.Path())
@click.argument("image2", metavar="IMG2", type=click.Path())
@click.option(
    "--out",
    required=True,
    type=OutputFile(),
    metavar="PATH.npz",
    help="Where to write the matches.",
)
@dataclass_options(MaskChoice, "masks")
@dataclass_options(MatcherOptions, "matcher")
def match(image1: str, image2: str, out: str, masks: MaskChoice, matcher: MatcherOptions) -> None:
    """Match two photographs and write the dense map and the matches selected from it.

    The file holds `map` (H, W, 2), for each cell of a grid over image 2 its point in image 1;
    `grid` (H, W, 2), the centres of the cells in image 2; `matchability` (H, W); and `points1`,
    `points2` (N, 2) and `confidence` (N), the matches, refined as --refine says. All points are in
    pixels of the upright original images.
    """
    with staged(out) as stage:
        first = masked(load_image(image1), masks.mask1, "mask1")
        second = masked(load_image(image2), masks.mask2, "mask2")
        result = matcher.load().match(first, second)
        dense = result.correspondence_map
        if dense is None:
            raise InputError(f"--weights {matcher.weights} gives no dense map")
        arrays = {"map": dense.map, "grid": dense.grid, "matchability": dense.matchability}
        write_npz(stage(out), arrays | matches_arrays(result.matches))
    for image in (first, second):
        if (turn := image.exif.orientation) != 1:
            say(
                f"{image.name}: EXIF orientation {turn} is applied: points are of the upright image"
            )
    click.echo(f"{out}: {len(result.matches)} matches of {dense.matchability.size} cells")
