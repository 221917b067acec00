"""`dgc-pose export-colmap`: a finished batch as a COLMAP database; `dgc-pose export`: a COLMAP
model in the format of another tool."""

from functools import partial
from pathlib import Path

import click

from dgc_pose.cli.batch import OUT
from dgc_pose.cli.guard import NamedPath, OutputFile, OutputFolder
from dgc_pose.cli.options import dataclass_options
from dgc_pose.cli.output import shared_text
from dgc_pose.cli.process import progress_bars
from dgc_pose.colmap.options import ReconstructionOptions
from dgc_pose.errors import ArgumentName, InputError
from dgc_pose.model import read_colmap, write_nerfstudio
from dgc_pose.system.files import replaced_folder, require_no_input

HLOC = ("features.h5", "matches.h5", "pairs.txt")  # files for hloc


@click.command()
@click.argument("folder", metavar="DIR", type=click.Path(path_type=Path))
@click.option("--database", type=OutputFile(), metavar="DB", help="The database to write.")
@click.option(
    "--hloc",
    type=OutputFolder(*HLOC, path_type=Path),
    metavar="DIR",
    help="Write features.h5, matches.h5 and pairs.txt there, as hloc's reconstruction reads them.",
)
@dataclass_options(ReconstructionOptions, "options", only=("per_image",))
def export_colmap(
    folder: Path, database: str | None, hloc: Path | None, options: ReconstructionOptions
) -> None:
    """Write the matches and poses of a batch as a COLMAP database.

    DIR is the folder of a finished `dgc-pose batch`. Only pairs with an accepted pose or rotation
    are written. The key points of the database have COLMAP's half-pixel offset.
    """
    from dgc_pose.batch.result import read_batch
    from dgc_pose.colmap.database import share, write_hloc, write_shared

    if database is None and hloc is None:
        raise InputError("give --database, or --hloc")
    batch = read_batch(folder)
    written = [Path(database)] if database else []
    written += [hloc / name for name in HLOC] if hloc else []
    images = [batch.plan.root / name for name in batch.plan.names]
    require_no_input(written, [*folder.iterdir(), *images])
    with progress_bars() as progress:
        shared = share(batch, options.per_image, partial(progress, "images"))
    if hloc is not None:
        write_hloc(hloc, shared)
        click.echo(f"{hloc}: {', '.join(HLOC)} of {len(shared.pairs)} pairs")
    if database is not None:
        write_shared(batch, shared, Path(database))
        click.echo(f"{database}: {shared_text(shared)}")


@click.command()
@click.argument("model", metavar="MODEL", type=NamedPath(path_type=Path))
@click.option("--to", type=click.Choice(["nerfstudio"]), required=True, help="The format.")
@click.option("--images", type=NamedPath(path_type=Path), help="Folder of the model's images.")
@OUT
def export(model: Path, to: str, images: Path | None, out: Path) -> None:
    """Write a COLMAP model in the format of another tool.

    MODEL is the folder of a COLMAP model, or a folder of `dgc-pose reconstruct`.
    """
    if out.exists():
        raise InputError(ArgumentName("out"), f"{out} exists already")
    read = read_colmap(model)
    with replaced_folder(out) as folder:
        write_nerfstudio(read, images, folder, out)
    click.echo(f"{out}: {read.num_images()} images for {to}")
