"""`dgc-pose train`: train a preset from photographs."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING

import click

if TYPE_CHECKING:
    from dgc_pose.training.depth_scenes import DepthScenes
    from dgc_pose.training.stages import Thawed
    from dgc_pose.training.start import InitPart
    from dgc_pose.training.warps import WarpOptions


@click.command()
@click.option(
    "--photos",
    required=True,
    type=click.Path(path_type=Path),
    help="Folder of photographs, searched through, or a pack of them (see docs/training.md); one "
    "in twenty is held back for validation.",
)
@click.option(
    "--preset",
    default="dgcm-lite",
    show_default=True,
    help="dgc, dgcm, dgcm-lite or dgcm-lite0.",
)
@click.option(
    "--ablation",
    "ablations",
    multiple=True,
    help="no-l2, flow, no-dilation, local-correlation, no-consensus, coarsest-alone or one-size; "
    "may be given several times.",
)
@click.option("--minutes", type=float, help="Of training: a complete schedule in so many.")
@click.option("--steps", type=int, help="The same in steps; such a run repeats exactly.")
@click.option(
    "--out", required=True, type=click.Path(path_type=Path), help="Folder of the run's files."
)
@click.option("--resume", is_flag=True, help="Go on with the run in --out.")
@click.option("--stop-after", type=float, help="Stop, to --resume later, after so many minutes.")
@click.option("--device", default="auto", show_default=True, help="auto, cpu or cuda.")
@click.option("--seed", default=0, show_default=True, help="Of all random draws.")
@click.option("--threads", type=int, default=None, help="CPU threads; default: torch's own choice.")
@click.option(
    "--split",
    default="45,45,10",
    show_default=True,
    help="Shares of the time for encoder, decoders and polish, in percent; or for encoder, its "
    "coarsest levels, decoders and polish.",
)
@click.option(
    "--scene-share",
    default=0.5,
    show_default=True,
    help="Share of the pairs that are ray-cast 3D scenes; the rest are warped photographs.",
)
@click.option(
    "--rgbd",
    "rgbd",
    multiple=True,
    type=click.Path(path_type=Path),
    help="Folder of posed RGB-D frames (K.txt, poses.txt, images, depth); may be repeated.",
)
@click.option(
    "--real-share",
    type=float,
    default=None,
    help="Share of the pairs from --rgbd; default: 0.25 with --rgbd.",
)
@click.option(
    "--warps",
    default="wide",
    show_default=True,
    help="Ranges of the warps: wide, paper, paper-affine, paper-affine-tps or paper-homography.",
)
@click.option("--curriculum", is_flag=True, help="From narrow ranges to full ones by half the run.")
@click.option("--init", help="Weights to start from: a file, or a shipped name.")
@click.option(
    "--init-part",
    type=click.Choice(["all", "encoder"]),
    default="all",
    show_default=True,
    help="Of the --init weights; the rest starts from random numbers.",
)
@click.option(
    "--body",
    help="ImageNet's weights of EfficientNet-Lite0 (.pth), which dgcm-lite0's encoder starts from.",
)
@click.option(
    "--rate",
    default=1.0,
    show_default=True,
    help="Times the stages' own learning rates; less, 0.1 say, with --init.",
)
@click.option(
    "--thaw",
    type=click.Choice(["coarsest", "encoder"]),
    default=None,
    help="The encoder, or its coarsest levels, goes on learning while the decoders do.",
)
@click.option("--teacher", help="Weights of a net with a mask to learn from, beside the truth.")
@click.option(
    "--teacher-weight", default=0.5, show_default=True, help="Of the teacher's map in the loss."
)
@click.option(
    "--batch",
    type=int,
    default=None,
    help="Pairs a step, over all processes; default: the stage's own.",
)
@click.option(
    "--precision",
    type=click.Choice(["auto", "float32", "bfloat16"]),
    default="auto",
    show_default=True,
    help="Of the convolutions; auto: bfloat16 where the processor multiplies it.",
)
@click.option(
    "--validation-pairs", default=64, show_default=True, help="Pairs of held-back photographs."
)
@click.option("--limit", type=int, default=None, help="Use so many photographs only.")
def train(
    photos: Path,
    preset: str,
    ablations: tuple[str, ...],
    minutes: float | None,
    steps: int | None,
    out: Path,
    resume: bool,
    stop_after: float | None,
    device: str,
    seed: int,
    threads: int | None,
    split: str,
    scene_share: float,
    rgbd: tuple[Path, ...],
    real_share: float | None,
    warps: str,
    curriculum: bool,
    init: str | None,
    init_part: InitPart,
    body: str | None,
    rate: float,
    thaw: Thawed | None,
    teacher: str | None,
    teacher_weight: float,
    batch: int | None,
    precision: str,
    validation_pairs: int,
    limit: int | None,
) -> None:
    """Train PRESET on photographs: encoder, then decoders, then polish.

    The run lives in --out: checkpoint.pt (written every minute; --resume goes on after any kill),
    a CSV log for each stage and, at the end, PRESET.safetensors.

    On several GPUs: torchrun --nproc-per-node N --no-python dgc-pose train ...
    """
    import torch

    from dgc_pose.network.device import choose_device, multiplies_bfloat16
    from dgc_pose.training.curriculum import Curriculum
    from dgc_pose.training.pairs import PairOptions
    from dgc_pose.training.photo_pack import load_photo_pack
    from dgc_pose.training.photos import load_photos
    from dgc_pose.training.processes import process_group, rank
    from dgc_pose.training.progress import ProgressLine
    from dgc_pose.training.run import RunOptions, Trainer
    from dgc_pose.training.schedule import Schedule

    if threads is not None:
        torch.set_num_threads(threads)
    chosen = choose_device(device)
    if real_share is None:
        real_share = 0.25 if rgbd else 0.0
    options = RunOptions(
        preset="+".join([preset, *ablations]),
        minutes=minutes,
        steps=steps,
        seed=seed,
        schedule=Schedule.parse(split),
        pairs=PairOptions(
            scene_share=scene_share, real_share=real_share, warps=_warps(warps)
        ),
        curriculum=Curriculum() if curriculum else None,
        init=init,
        init_part=init_part,
        body=body,
        rate=rate,
        thaw=thaw,
        teacher=teacher,
        teacher_weight=teacher_weight,
        batch=batch,
        half_precision=precision == "bfloat16"
        or (precision == "auto" and multiplies_bfloat16(chosen)),
        validation_count=validation_pairs,
    )
    if stop_after is not None and not stop_after > 0:
        raise click.BadParameter("must be positive", param_hint="--stop-after")
    if real_share > 0 and not rgbd:
        raise click.BadParameter("needs --rgbd", param_hint="--real-share")
    with process_group(chosen) as own_device:
        is_pack = photos.suffix == ".safetensors"
        trainer = Trainer(
            load_photo_pack(photos, limit) if is_pack else load_photos(photos, limit=limit),
            out,
            options,
            real=_real_scenes(rgbd),
            device=own_device,
            resume=resume,
        )
        trainer.run(ProgressLine(options), stop_after)
        if rank() > 0:
            return
    if trainer.complete:
        click.echo(f"wrote {trainer.weights_path}")
    else:
        length = f"{steps} steps" if minutes is None else f"{minutes:g} minutes"
        done = trainer.step if minutes is None else f"{trainer.elapsed / 60:.1f}"
        click.echo(f"stopped after {done} of {length}")


def _warps(name: str) -> WarpOptions:
    from dgc_pose.training.warps import WARPS

    if name not in WARPS:
        raise click.BadParameter(f"must be one of {', '.join(WARPS)}", param_hint="--warps")
    return WARPS[name]


def _real_scenes(folders: tuple[Path, ...]) -> DepthScenes | None:
    """The frames that train; the rest of each walk is held back."""
    from dgc_pose.training.depth_scenes import hold_back, load_depth_scenes
    from dgc_pose.training.posed_depth import read_rgbd

    if not folders:
        return None
    return load_depth_scenes([hold_back(read_rgbd(folder))[0] for folder in folders])
