"""`dgc-pose fit-folders`: fit what a folder believes of its pairs before it compares them."""

from dataclasses import dataclass
from pathlib import Path

import click
from tqdm import tqdm

from dgc_pose.cli.guard import OutputFolder
from dgc_pose.cli.options import dataclass_options
from dgc_pose.errors import require
from dgc_pose.system.options import option


@dataclass(frozen=True)
class FolderFitChoice:
    """What is matched and fitted."""

    data: Path = option(help="Folder with the folders photos, of textures, and posed, of scenes.")
    out: Path = option(help="Folder of images and batches.", type=OutputFolder(path_type=Path))
    folders: int = option(4, "Seeds of each kind of folder.", metavar="N", min=1, max=1000)


@click.command()
@dataclass_options(FolderFitChoice, "choice")
def fit_folders(choice: FolderFitChoice) -> None:
    """Fit the weights of `batch/look_alikes.py`: match, label, fit.

    Folders with repeats are rendered. Their pairs, and those of as many posed scenes, are matched
    in --out, and the same command goes on after any kill. Needs scikit-learn (the extra "fit").
    """
    require({"fit-folders": "fit"})  # before the work
    from dgc_pose.benchmarks.folders import collected, fit, folder_names

    names = folder_names(choice.data, choice.folders)
    bar = tqdm(names, unit="folder", disable=None)
    click.echo(fit({name: collected(name, choice.data, choice.out) for name in bar}))
