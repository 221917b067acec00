"""`dgc-pose train`: train a preset from photographs."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import click


@click.command()
@click.option(
    "--photos",
    required=True,
    type=click.Path(path_type=Path),
    help="Folder of photographs, searched through; one in twenty is held back for validation.",
)
@click.option("--preset", default="dgcm-lite", show_default=True, help="dgc, dgcm or dgcm-lite.")
@click.option("--minutes", required=True, type=float, help="Of training; a complete schedule.")
@click.option(
    "--out", required=True, type=click.Path(path_type=Path), help="Folder of the run's files."
)
@click.option("--resume", is_flag=True, help="Go on with the run in --out.")
@click.option("--device", default="auto", show_default=True, help="auto, cpu or cuda.")
@click.option("--seed", default=0, show_default=True, help="Of all random draws.")
@click.option("--threads", type=int, default=None, help="CPU threads; default: torch's own choice.")
@click.option(
    "--split",
    default="45,45,10",
    show_default=True,
    help="Shares of the time for encoder, decoders and polish, in percent.",
)
@click.option(
    "--scene-share",
    default=0.5,
    show_default=True,
    help="Share of the pairs that are ray-cast 3D scenes; the rest are warped photographs.",
)
@click.option(
    "--warps",
    type=click.Choice(["wide", "paper"]),
    default="wide",
    show_default=True,
    help="Ranges of the affine, thin-plate-spline and homography warps.",
)
@click.option("--batch", type=int, default=None, help="Pairs a step; default: the stage's own.")
@click.option(
    "--validation-pairs", default=64, show_default=True, help="Pairs of held-back photographs."
)
@click.option("--limit", type=int, default=None, help="Use so many photographs only.")
def train(
    photos: Path,
    preset: str,
    minutes: float,
    out: Path,
    resume: bool,
    device: str,
    seed: int,
    threads: int | None,
    split: str,
    scene_share: float,
    warps: str,
    batch: int | None,
    validation_pairs: int,
    limit: int | None,
) -> None:
    """Train PRESET from scratch on photographs: encoder, then decoders, then polish.

    The run lives in --out: checkpoint.pt (written every minute; --resume goes on after any kill),
    a CSV log for each stage and, at the end, PRESET.safetensors.
    """
    import torch

    from dgc_pose.network.device import choose_device
    from dgc_pose.training.pairs import PairOptions
    from dgc_pose.training.photos import load_photos
    from dgc_pose.training.run import RunOptions, Trainer
    from dgc_pose.training.schedule import Schedule
    from dgc_pose.training.warps import PAPER, WIDE

    if threads is not None:
        torch.set_num_threads(threads)
    options = RunOptions(
        preset=preset,
        minutes=minutes,
        seed=seed,
        schedule=Schedule(*_percent(split)),
        pairs=PairOptions(scene_share=scene_share, warps=WIDE if warps == "wide" else PAPER),
        batch=batch,
        validation_count=validation_pairs,
    )
    chosen = choose_device(device)
    trainer = Trainer(
        load_photos(photos, limit=limit), out, options, device=chosen, resume=resume
    )
    trainer.run(_ProgressLine(minutes))
    click.echo(f"wrote {out / preset}.safetensors")


def _percent(text: str) -> tuple[float, float, float]:
    try:
        encoder, decoders, polish = (float(part) / 100 for part in text.split(","))
    except ValueError:
        message = "must be three percentages: 45,45,10"
        raise click.BadParameter(message, param_hint="--split") from None
    return encoder, decoders, polish


class _ProgressLine:
    """A line every half minute: the stage, the rate, the losses and, when measured, validation."""

    def __init__(self, minutes: float) -> None:
        self._minutes = minutes
        self._next = 0.0

    def __call__(self, row: dict[str, Any]) -> None:
        validation = {k[4:]: v for k, v in row.items() if k.startswith("val_")}
        if row["minutes"] < self._next and not validation:
            return
        self._next = row["minutes"] + 0.5
        details = {k: v for k, v in row.items() if k.startswith(("found", "epe"))}
        text = (
            f"{row['minutes']:6.1f}/{self._minutes:g} min  {row['stage']:8s} "
            f"step {row['step']:6d}  "
            f"{row['pairs_per_second']:6.1f} pairs/s "
            f"(making them {100 * row['seconds_making_pairs'] / row['seconds']:.0f} %)  "
            f"loss {row['loss']:.3f}  " + _join(details)
        )
        if validation:
            text += "\n    validation  " + _join(validation)
        click.echo(text, err=True)


def _join(figures: dict[str, float]) -> str:
    return "  ".join(f"{name} {value:.3f}" for name, value in figures.items())
