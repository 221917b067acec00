"""`dgc-pose train`: train a preset on photographs."""

from __future__ import annotations

from dataclasses import dataclass, replace
from pathlib import Path
from typing import TYPE_CHECKING, Literal

import click

from dgc_pose.cli.dataclass_options import dataclass_options
from dgc_pose.cli.guard import OutputFolder
from dgc_pose.files.outputs import only_writer
from dgc_pose.system.options import check_options, option
from dgc_pose.training.options import TrainingOptions

if TYPE_CHECKING:
    from dgc_pose.training.synthesis.depth_scenes import DepthScenes


@dataclass(frozen=True)
class TrainFiles:
    """Where a run reads and writes, and how it uses the machine."""

    photos: Path = option(
        help="Folder of photographs, searched through; one in twenty is held back for validation."
    )
    out: Path = option(help="Folder of the run's files.", type=OutputFolder(path_type=Path))
    resume: bool = option(False, "Continue the run in --out.")
    stop_after: float | None = option(
        None, "Stop after so many minutes; --resume continues the run.", above=0, max=10**7
    )
    device: str = option("auto", "Where the network is trained: auto, cpu or cuda.")
    threads: int | None = option(None, "CPU threads; default: torch's own choice.", min=1, max=1024)
    rgbd: tuple[Path, ...] = option(
        (), "Folder of posed RGB-D frames (K.txt, poses.txt, images, depth); may be repeated."
    )
    real_share: float | None = option(
        None, "Share of the pairs from --rgbd; default: 0.25 with --rgbd.", min=0, max=1
    )
    real_pairs: Literal["near", "far"] = option(
        "near",
        "Which frames make a pair: near, up to 60 degrees apart; far, up to 90, and far views "
        "likelier than near ones.",
    )
    limit: int | None = option(None, "Most photographs to use.", min=1, max=10**9)

    def __post_init__(self) -> None:
        check_options(self)
        if self.real_share and not self.rgbd:
            raise click.BadParameter("needs --rgbd", param_hint="--real-share")

    def load_real(self) -> DepthScenes | None:
        """The frames that train; the rest of each sequence is held back."""
        from dgc_pose.training.synthesis.depth_scenes import (
            FRAME_PAIRS,
            load_depth_scenes,
            training_frames,
        )
        from dgc_pose.training.synthesis.posed_depth import read_rgbd

        if not self.rgbd:
            return None
        scenes = [training_frames(read_rgbd(folder)) for folder in self.rgbd]
        return load_depth_scenes(scenes, FRAME_PAIRS[self.real_pairs])


@click.command()
@dataclass_options(TrainFiles, "files")
@dataclass_options(TrainingOptions, "options")
def train(files: TrainFiles, options: TrainingOptions) -> None:
    """Train a preset on photographs: encoder, then decoders, then polish (decoders end to end).

    The run's folder --out holds checkpoint.pt (written every minute; --resume continues from it
    after any kill), a CSV log for each stage and, at the end, the weights as .safetensors.
    """
    import torch

    from dgc_pose.network.weights import choose_device
    from dgc_pose.training.log import ProgressLine
    from dgc_pose.training.run import Trainer
    from dgc_pose.training.synthesis.photos import load_photos

    if files.threads is not None:
        torch.set_num_threads(files.threads)
    device = choose_device(files.device)
    default_share = 0.25 if files.rgbd else 0.0
    real_share = default_share if files.real_share is None else files.real_share
    options = replace(options, pairs=replace(options.pairs, real_share=real_share))
    photos, real = load_photos(files.photos, limit=files.limit), files.load_real()
    trainer = Trainer(photos, files.out, options, real, device, files.resume)
    with only_writer(files.out):
        trainer.run(ProgressLine(options), files.stop_after)
    if trainer.complete:
        click.echo(f"wrote {trainer.weights_path}")
    elif options.minutes is None:
        click.echo(f"stopped after {trainer.step} of {options.steps} steps")
    else:
        click.echo(f"stopped after {trainer.elapsed / 60:.1f} of {options.minutes:g} minutes")
