"""How fast pairs are made: `python -m dgc_pose.training.rates --photos DIR [--rgbd DIR]`.

A network in training takes as many pairs a second as `dgc-pose train` prints; where the generator
makes more, it does not hold the network back.
"""

from __future__ import annotations

import time
from dataclasses import replace
from pathlib import Path

import click
import torch

from dgc_pose.errors import DgcPoseError
from dgc_pose.network.device import choose_device
from dgc_pose.training.depth_scenes import DepthScenes, load_depth_scenes
from dgc_pose.training.pairs import PairOptions, make_pairs
from dgc_pose.training.photos import Photos, load_photos
from dgc_pose.training.posed_depth import read_rgbd


def measure_rates(
    photos: Photos,
    real: DepthScenes | None = None,
    *,
    batch: int = 16,
    size: int = 240,
    seconds: float = 5.0,
    options: PairOptions | None = None,
) -> dict[str, float]:
    """Pairs a second of each kind, photometric changes included, on the device of `photos`.

    Each kind is made for about `seconds`, after one batch that does not count.
    """
    options = options or PairOptions()
    kinds = {"warped photographs": (0.0, 0.0), "ray-cast scenes": (1.0, 0.0)}
    if real is not None:
        kinds["real scenes"] = (0.0, 1.0)
    rates = {}
    for name, (scene_share, real_share) in kinds.items():
        chosen = replace(options, scene_share=scene_share, real_share=real_share)
        generator = torch.Generator().manual_seed(0)
        make_pairs(photos, batch, size, generator, chosen, real)
        _wait(photos)
        started = time.perf_counter()
        made = 0
        while made == 0 or time.perf_counter() - started < seconds:
            make_pairs(photos, batch, size, generator, chosen, real)
            _wait(photos)
            made += batch
        rates[name] = made / (time.perf_counter() - started)
    return rates


def _wait(photos: Photos) -> None:
    """Until the device has done what it was told."""
    if photos.pixels.device.type == "cuda":
        torch.cuda.synchronize(photos.pixels.device)


@click.command()
@click.option("--photos", required=True, type=click.Path(path_type=Path), help="Folder of photos.")
@click.option("--rgbd", type=click.Path(path_type=Path), help="A posed RGB-D folder.")
@click.option("--device", default="auto", show_default=True, help="auto, cpu or cuda.")
@click.option("--threads", type=click.IntRange(1), help="CPU threads; default: torch's own choice.")
@click.option("--batch", type=click.IntRange(1), default=16, show_default=True, help="Pairs.")
@click.option("--size", type=click.IntRange(32), default=240, show_default=True, help="Pixels.")
@click.option("--seconds", default=5.0, show_default=True, help="For each kind.")
@click.option("--limit", type=click.IntRange(40), default=200, show_default=True, help="Photos.")
def main(
    photos: Path,
    rgbd: Path | None,
    device: str,
    threads: int | None,
    batch: int,
    size: int,
    seconds: float,
    limit: int,
) -> None:
    """Print how many pairs a second are made of each kind."""
    if threads is not None:
        torch.set_num_threads(threads)
    try:
        chosen = choose_device(device)
        held, _ = load_photos(photos, limit=limit)
        real = None if rgbd is None else load_depth_scenes([read_rgbd(rgbd)]).to(chosen)
        rates = measure_rates(held.to(chosen), real, batch=batch, size=size, seconds=seconds)
    except DgcPoseError as error:
        raise click.ClickException(str(error)) from None
    where = torch.cuda.get_device_name(chosen) if chosen.type == "cuda" else "cpu"
    click.echo(f"{where}: batches of {batch} pairs of {size} x {size} pixels")
    for name, rate in rates.items():
        click.echo(f"{name:20s} {rate:8.1f} pairs/s")


if __name__ == "__main__":
    main()
