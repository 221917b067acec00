"""`dgc-pose export`: a COLMAP model in the format of another tool."""

from pathlib import Path

import click

from dgc_pose.adapters.model_formats import FORMATS
from dgc_pose.cli.batch import OUT
from dgc_pose.cli.guard import NamedPath
from dgc_pose.errors import ArgumentName, InputError
from dgc_pose.files.outputs import replaced_folder
from dgc_pose.model import read_colmap


@click.command()
@click.argument("model", metavar="MODEL", type=NamedPath(path_type=Path))
@click.option("--to", type=click.Choice([*FORMATS]), required=True, help="The format.")
@click.option("--images", type=NamedPath(path_type=Path), help="Folder of the model's images.")
@OUT
def export(model: Path, to: str, images: Path | None, out: Path) -> None:
    """Write a COLMAP model in the format of another tool.

    MODEL is a folder of COLMAP's files or of `dgc-pose reconstruct`. openmvs needs --images. The
    times of tum are the names of the images if all are numbers, else 0, 1, ... in their order.
    """
    if out.exists():
        raise InputError(ArgumentName("out"), f"{out} is there already")
    read = read_colmap(model)
    with replaced_folder(out) as folder:
        FORMATS[to](read, images, folder, out)
    click.echo(f"{out}: {read.num_images()} images for {to}")
