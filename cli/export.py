"""`dgc-pose export`: a COLMAP model in the format of another tool."""

from pathlib import Path

import click

from dgc_pose.cli.batch import OUT
from dgc_pose.cli.guard import NamedPath
from dgc_pose.errors import ArgumentName, InputError
from dgc_pose.files.outputs import replaced_folder
from dgc_pose.model import read_colmap, write_nerfstudio


@click.command()
@click.argument("model", metavar="MODEL", type=NamedPath(path_type=Path))
@click.option("--to", type=click.Choice(["nerfstudio"]), required=True, help="The format.")
@click.option("--images", type=NamedPath(path_type=Path), help="Folder of the model's images.")
@OUT
def export(model: Path, to: str, images: Path | None, out: Path) -> None:
    """Write a COLMAP model in the format of another tool.

    MODEL is a folder of COLMAP's files or of `dgc-pose reconstruct`.
    """
    if out.exists():
        raise InputError(ArgumentName("out"), f"{out} is there already")
    read = read_colmap(model)
    with replaced_folder(out) as folder:
        write_nerfstudio(read, images, folder, out)
    click.echo(f"{out}: {read.num_images()} images for {to}")
