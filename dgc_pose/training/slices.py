"""Training in slices on a bare machine: no network, minutes at a time, few and small files.

    python -m dgc_pose.training.slices pack --photos DIR --out PACK
    python -m dgc_pose.training.slices run --pack PACK --minutes 8.5 --total-minutes 25.5 --out OUT
    python -m dgc_pose.training.slices pack --photos DIR --out PACK2 --state OUT     ... and so on
    python -m dgc_pose.training.slices join OUT dgcm.safetensors

The code need not be installed: the repository's root will do. docs/training.md has the whole way.
"""

from __future__ import annotations

import io
import os
import shutil
import sys
import tempfile
from pathlib import Path
from typing import Any

import click
import torch

from dgc_pose.errors import DgcPoseError, InputError
from dgc_pose.network.device import choose_device, multiplies_bfloat16
from dgc_pose.network.weights import load_checkpoint, save_weights
from dgc_pose.training.carry import join_halves, read_parts, write_halves, write_parts
from dgc_pose.training.compact import compacted
from dgc_pose.training.pairs import PairOptions
from dgc_pose.training.photo_pack import load_photo_pack, pack_photos
from dgc_pose.training.photos import load_photos
from dgc_pose.training.progress import ProgressLine
from dgc_pose.training.run import CHECKPOINT, RunOptions, Trainer
from dgc_pose.training.schedule import Schedule
from dgc_pose.training.warps import WARPS

PHOTOS = "photos.safetensors"
STATE = "state"
_FOLDER = click.Path(path_type=Path)


@click.group()
def slices() -> None:
    """Train a network in slices that resume each other, on a machine with nothing but torch."""


@slices.command()
@click.option("--photos", required=True, type=_FOLDER, help="Folder of photographs.")
@click.option("--out", required=True, type=_FOLDER, help="The pack, a new folder.")
@click.option("--state", type=_FOLDER, help="What the last slice wrote, or a run's folder.")
@click.option("--limit-mib", default=52.0, show_default=True, help="Of the whole pack.")
def pack(photos: Path, out: Path, state: Path | None, limit_mib: float) -> None:
    """Pack photographs, and the state to go on from, into a folder of a size that can travel.

    The code travels beside it; leave room for it in --limit-mib.
    """
    if out.exists():
        raise InputError(f"{out} is there already")
    content = None if state is None else _packed_state(state)
    room = int(limit_mib * 2**20) - len(content or b"")
    if room <= 0:
        raise InputError(f"the state alone takes {len(content or b'') / 2**20:.1f} MiB")
    loaded = load_photos(photos)
    out.parent.mkdir(parents=True, exist_ok=True)
    staged = out.with_name(f".{out.name}.{os.getpid()}.partial")
    staged.mkdir()
    try:
        quality = pack_photos(loaded, staged / PHOTOS, room)
        if content is not None:
            write_parts(content, staged, STATE)
        os.rename(staged, out)
    except BaseException:
        shutil.rmtree(staged)
        raise
    size = sum(path.stat().st_size for path in out.iterdir()) / 2**20
    count = sum(len(part.pixels) for part in loaded)
    click.echo(f"wrote {out}: {size:.1f} MiB, {count} photographs at quality {quality}")


@slices.command()
@click.option("--pack", "packed", required=True, type=_FOLDER, help="What `pack` wrote.")
@click.option("--out", required=True, type=_FOLDER, help="Folder of what is to come back.")
@click.option("--preset", default="dgcm", show_default=True, help="Or dgcm+flow and the like.")
@click.option("--minutes", default=8.5, show_default=True, help="Of training in this slice.")
@click.option(
    "--total-minutes", default=25.5, show_default=True, help="Of all slices: a complete schedule."
)
@click.option(
    "--trial", is_flag=True, help="One minute as a complete run, from nothing and kept nowhere."
)
@click.option(
    "--work",
    type=_FOLDER,
    help="Where the whole state stays, should the machine; default: runs/PRESET.",
)
@click.option("--split", default="45,45,10", show_default=True, help="Percent of each stage.")
@click.option("--seed", default=0, show_default=True, help="Of all random draws.")
@click.option("--scene-share", default=0.5, show_default=True, help="Pairs of ray-cast scenes.")
@click.option("--warps", type=click.Choice(list(WARPS)), default="wide", show_default=True)
@click.option("--init", help="Weights to start from.")
@click.option("--rate", default=1.0, show_default=True, help="Times the stages' own rates.")
@click.option("--teacher", help="Weights of a net with a mask to learn from.")
@click.option("--batch", type=int, help="Pairs a step; default: the stage's own.")
@click.option("--validation-pairs", default=64, show_default=True)
@click.option("--device", default="auto", show_default=True, help="auto, cpu or cuda.")
def run(
    packed: Path,
    out: Path,
    preset: str,
    minutes: float,
    total_minutes: float,
    trial: bool,
    work: Path | None,
    split: str,
    seed: int,
    scene_share: float,
    warps: str,
    init: str | None,
    rate: float,
    teacher: str | None,
    batch: int | None,
    validation_pairs: int,
    device: str,
) -> None:
    """Train one slice: from the pack's state, or from the work folder's where that is further.

    Writes to --out the state for the next slice in parts of at most 15 MiB, encoder and decoders
    by the averaged weights in half precision, and the logs.
    """
    chosen = choose_device(device)
    options = RunOptions(
        preset=preset,
        minutes=1.0 if trial else total_minutes,
        seed=seed,
        schedule=Schedule.parse(split),
        pairs=PairOptions(scene_share=scene_share, warps=WARPS[warps]),
        init=init,
        rate=rate,
        teacher=teacher,
        batch=batch,
        half_precision=multiplies_bfloat16(chosen),
        validation_count=validation_pairs,
        validate_minutes=0.25 if trial else 3.0,
    )
    if not minutes > 0:
        raise InputError(f"minutes must be positive, not {minutes}")
    out.mkdir(parents=True, exist_ok=True)
    with tempfile.TemporaryDirectory() as nowhere:
        folder = Path(nowhere) if trial else work or Path("runs") / preset
        if not trial:
            _take_over(packed, folder)
        photos = load_photo_pack(packed / PHOTOS, device=chosen)
        trainer = Trainer(photos, folder, options, device=chosen, resume=True)
        net = trainer.run(ProgressLine(options), None if trial else minutes)
        for stale in out.glob(f"{STATE}-*-of-*"):
            stale.unlink()
        if not trainer.complete:
            write_parts(_bytes(compacted(trainer.state())), out, STATE)
        write_halves(net, out)
        _write_logs(folder, out / f"{preset}-logs.txt")
    done = trainer.elapsed / 60
    click.echo(f"{done:.1f} of {options.minutes:g} minutes; {trainer.step} steps; wrote {out}")


@slices.command()
@click.argument("folder", type=_FOLDER)
@click.argument("weights", type=_FOLDER)
def join(folder: Path, weights: Path) -> None:
    """Join the encoder and the decoders in FOLDER into one file of WEIGHTS."""
    save_weights(join_halves(folder), weights)
    click.echo(f"wrote {weights}")


def _packed_state(folder: Path) -> bytes:
    """The state in a slice's output, or a run's checkpoint made compact."""
    content = read_parts(folder, STATE)
    if content is not None:
        return content
    if not (folder / CHECKPOINT).is_file():
        raise InputError(f"{folder}: neither a slice's state nor a run's {CHECKPOINT}")
    return _bytes(compacted(load_checkpoint(folder / CHECKPOINT)))


def _take_over(packed: Path, work: Path) -> None:
    """Put the pack's state into the work folder, unless what is there is as far or further."""
    content = read_parts(packed, STATE)
    if content is None:
        return
    work.mkdir(parents=True, exist_ok=True)
    arrived, checkpoint = work / "arrived.pt", work / CHECKPOINT
    arrived.write_bytes(content)
    if checkpoint.exists():
        there, here = load_checkpoint(arrived)["step"], load_checkpoint(checkpoint)["step"]
        if here >= there:
            arrived.unlink()
            return
    os.replace(arrived, checkpoint)


def _write_logs(run: Path, path: Path) -> None:
    """All logs in one file, each under its name."""
    logs = sorted(run.glob("*_log.csv"))
    path.write_text("\n".join(f"{log.name}\n{log.read_text()}" for log in logs))


def _bytes(state: dict[str, Any]) -> bytes:
    file = io.BytesIO()
    torch.save(state, file)
    return file.getvalue()


def main() -> None:
    """The command; what is wrong with its input is told in one line, with exit code 2."""
    try:
        slices(standalone_mode=False)
    except (click.ClickException, DgcPoseError, OSError) as error:
        message = error.format_message() if isinstance(error, click.ClickException) else str(error)
        click.echo(f"error: {message}", err=True)
        sys.exit(2)


if __name__ == "__main__":
    main()
