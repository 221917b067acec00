"""`dgc-pose export-colmap`: a finished batch as a COLMAP database."""

from __future__ import annotations

from functools import partial
from pathlib import Path
from typing import TYPE_CHECKING

import click

from dgc_pose.cli.dataclass_options import dataclass_options
from dgc_pose.cli.guard import OutputFile, OutputFolder
from dgc_pose.cli.progress import progress_bars
from dgc_pose.colmap.options import ReconstructionOptions
from dgc_pose.errors import InputError
from dgc_pose.files.outputs import require_no_input

if TYPE_CHECKING:
    from dgc_pose.colmap.tracking import SharedMatches

HLOC = ("features.h5", "matches.h5", "pairs.txt")  # that hloc reads


def described(shared: SharedMatches) -> str:
    """A line on what was written."""
    images = sum(len(points) > 0 for points in shared.key_points.values())
    key_points, matches = (sum(map(len, m.values())) for m in (shared.key_points, shared.pairs))
    return f"{images} images, {key_points} key points, {len(shared.pairs)} pairs, {matches} matches"


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

    DIR is the folder of a finished `dgc-pose batch`. Pairs without a pose or a rotation are left
    out. The key points have COLMAP's half-pixel offset.
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
        click.echo(f"{database}: {described(shared)}")
