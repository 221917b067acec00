"""`dgc-pose train`: train a network preset on photographs."""

from __future__ import annotations

from contextlib import suppress
from dataclasses import dataclass
from pathlib import Path

import click

from dgc_pose.cli.guard import OutputFolder
from dgc_pose.cli.options import dataclass_options
from dgc_pose.system.files import only_writer
from dgc_pose.system.options import option
from dgc_pose.training.options import TrainingOptions


@dataclass(frozen=True)
class TrainFiles:
    """The inputs and outputs of a run, and its device."""

    photos: Path = option(
        help="Folder of photographs, searched through; one in twenty is held back for validation."
    )
    out: Path = option(help="Folder of the run's files.", type=OutputFolder(path_type=Path))
    posed: tuple[Path, ...] = option(
        (),
        "Folder of posed photographs, or of such folders: a COLMAP model or posed RGB-D, with "
        "images; may be repeated.",
    )
    light: Path | None = option(
        None, "Folder of folders, each with aligned photographs of one place in other light."
    )
    held: tuple[str, ...] = option(
        (), "Name of a scene of --posed that validates and does not train; may be repeated."
    )
    resume: bool = option(False, "Continue the run in --out.")
    device: str = option("auto", "Where the network is trained: auto, cpu or cuda.")


@click.command()
@dataclass_options(TrainFiles, "files")
@dataclass_options(TrainingOptions, "options")
def train(files: TrainFiles, options: TrainingOptions) -> None:
    """Train a preset on photographs: the encoder, then the decoders.

    Writes into --out: checkpoint.pt every minute (--resume continues from it after any kill),
    log.jsonl, the depths estimated for posed photographs and, at the end, the weights as
    .safetensors with a card as .md.
    """
    from dgc_pose.network.weights import choose_device
    from dgc_pose.training.pairs import load_data
    from dgc_pose.training.run import Trainer

    device = choose_device(files.device)
    files.out.mkdir(parents=True, exist_ok=True)
    with only_writer(files.out):
        try:
            trainer = Trainer(files.out, options, device, files.resume)
            data = load_data(
                files.photos,
                files.light,
                files.posed,
                depths=files.out / "depths",
                held=files.held,
                shares=options.shares,
                device=device,
            )
            trainer.run(data)
        finally:
            with suppress(OSError):  # a run that cannot start leaves no empty folder
                files.out.rmdir()
    click.echo(f"wrote {trainer.weights_path}")
