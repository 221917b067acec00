"""`dgc-pose export-colmap`: a finished batch as a COLMAP database."""

from __future__ import annotations

from functools import partial
from pathlib import Path
from typing import TYPE_CHECKING

import click

from dgc_pose.cli.dataclass_options import dataclass_options
from dgc_pose.cli.guard import OutputFile
from dgc_pose.cli.progress import progress_bars
from dgc_pose.colmap.options import ReconstructionOptions
from dgc_pose.files.outputs import require_no_input

if TYPE_CHECKING:
    from dgc_pose.colmap.shared import SharedMatches


def described(shared: SharedMatches) -> str:
    """A line on what was written."""
    images = sum(len(points) > 0 for points in shared.key_points.values())
    key_points, matches = (sum(map(len, m.values())) for m in (shared.key_points, shared.pairs))
    return f"{images} images, {key_points} key points, {len(shared.pairs)} pairs, {matches} matches"


@click.command()
@click.argument("folder", metavar="DIR", type=click.Path(path_type=Path))
@click.option(
    "--database", type=OutputFile(), required=True, metavar="DB", help="The database to write."
)
@dataclass_options(ReconstructionOptions, "options", only=("per_image",))
def export_colmap(folder: Path, database: str, options: ReconstructionOptions) -> None:
    """Write the matches and poses of a batch as a COLMAP database.

    DIR is the folder of a finished `dgc-pose batch`. Pairs without a pose or a rotation are left
    out. The key points have COLMAP's half-pixel offset.
    """
    from dgc_pose.batch.result import read_batch
    from dgc_pose.colmap.export import share, write_shared

    batch = read_batch(folder)
    images = [batch.plan.root / name for name in batch.plan.names]
    require_no_input([database], [*folder.iterdir(), *images])
    with progress_bars() as progress:
        shared = share(batch, options.per_image, partial(progress, "images"))
    write_shared(batch, shared, Path(database))
    click.echo(f"{database}: {described(shared)}")
