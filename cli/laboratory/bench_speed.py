"""`dgc-pose bench-speed`: where the time of a pair goes."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import asdict, dataclass
from functools import partial
from pathlib import Path
from typing import TYPE_CHECKING, get_args

import click
import cv2

from dgc_pose.cli.dataclass_options import dataclass_options
from dgc_pose.cli.guard import OutputFile
from dgc_pose.cli.options import split_names
from dgc_pose.errors import InputError
from dgc_pose.estimation.options import Effort
from dgc_pose.files.json_files import finite_data, json_text
from dgc_pose.files.outputs import save_text, scratch_folder, staged
from dgc_pose.files.tables import table
from dgc_pose.images.image import load_image
from dgc_pose.matchers import MatcherOptions, refined
from dgc_pose.matching import DEFAULT_WEIGHTS, load_dense_matcher
from dgc_pose.network.config import INPUT_SIZE, preset
from dgc_pose.runtime.load import DEVICE_HELP, RUNTIME_HELP, RuntimeName, device_type
from dgc_pose.runtime.onnx_engine import OnnxEngine
from dgc_pose.system.options import option

if TYPE_CHECKING:
    from dgc_pose.benchmarks.speed import Setup
    from dgc_pose.network.correspondence_net import CorrespondenceNet


@dataclass(frozen=True)
class SpeedOptions:
    """What is timed."""

    weights: str = option(DEFAULT_WEIGHTS, "Name or path.")
    forward: str = option(
        "dgcm", "Comma-separated presets whose forward passes, with random weights, are timed too."
    )
    repetitions: int = option(7, "Their median counts.", min=1, max=10**6)
    threads: int | None = option(
        None, "Threads of torch and OpenCV; default: their own choice.", min=1, max=1024
    )
    device: str = option("cpu", DEVICE_HELP, metavar="NAME")
    runtime: RuntimeName = option("auto", RUNTIME_HELP, metavar="NAME", section="matching")
    half_precision: bool = option(False, "The network's convolutions in bfloat16, by torch.")
    json_path: str | None = option(
        None, "Write all figures as JSON.", flag="--json", metavar="PATH", type=OutputFile()
    )


@click.command()
@click.argument("image1", required=False, type=click.Path(path_type=Path))
@click.argument("image2", required=False, type=click.Path(path_type=Path))
@click.argument("k", metavar="[K]", required=False)
@dataclass_options(SpeedOptions, "options")
def bench_speed(
    image1: Path | None, image2: Path | None, k: str | None, options: SpeedOptions
) -> None:
    """Time the pipeline stage by stage, and the network's ways to run.

    Without images it takes the bundled pair, enlarged to 1600x1200.
    """
    import torch

    from dgc_pose.benchmarks.speed import Setup, bundled_setup, user_setup
    from dgc_pose.network.weights import build_network, load_network

    with staged(options.json_path) as stage, scratch_folder() as folder:
        if options.threads is not None:
            torch.set_num_threads(options.threads)
            cv2.setNumThreads(options.threads)
        configs = {f"{name}, random": preset(name) for name in split_names(options.forward)}
        device = device_type(options.device)
        wanted = MatcherOptions(options.weights, device, options.runtime, options.half_precision)
        if not wanted.kind.network:
            what = "the stages are those of a network that refines its matches"
            raise InputError(f"--weights {options.weights}: {what}")
        dense = load_dense_matcher(
            options.weights,
            device=device,
            runtime=options.runtime,
            half_precision=options.half_precision,
        )
        pair = bundled_setup(folder) if image1 is None else user_setup(image1, image2, k)
        nets = {dense.name: load_network(options.weights)}
        for name, config in configs.items():
            torch.manual_seed(0)
            nets[name] = build_network(config).eval().requires_grad_(False)
        nets = {name: net.to(device) for name, net in nets.items()}
        setup = Setup(*pair, dense, refined(dense, wanted), device)
        data = _measure(setup, nets, options.repetitions)
        if options.json_path is not None:
            save_text(stage(options.json_path), json_text(finite_data(data)))


def _measure(
    setup: Setup, nets: Mapping[str, CorrespondenceNet], repetitions: int
) -> dict[str, object]:
    """Measure, print, and return what is written as JSON."""
    import torch

    from dgc_pose.benchmarks.speed import (
        FORWARD_COLUMNS,
        SIFT,
        TOTAL,
        matrix_rate,
        stages,
        stages_text,
        time_forwards,
    )
    from dgc_pose.runtime.torch_engine import network_input

    images = [load_image(path) for path in (setup.path1, setup.path2)]
    facts = {
        "weights": setup.dense.name,
        "device": setup.device,
        "runtime": "onnx" if isinstance(setup.dense.engine, OnnxEngine) else "torch",
        "size": "x".join(map(str, images[0].size)),
        "repetitions": repetitions,
        "torch_threads": torch.get_num_threads(),
        "opencv_threads": cv2.getNumThreads(),
        "torch": torch.__version__,
    }
    click.echo(", ".join(f"{name} {value}" for name, value in facts.items()))
    rate = partial(matrix_rate, setup.device)
    timed = stages(setup, repetitions, rate)
    click.echo("\n" + stages_text(timed) + "\n")
    size, device = (INPUT_SIZE, INPUT_SIZE), torch.device(setup.device)
    inputs = [network_input(image.pixels, size, device) for image in images]
    forwards = [
        forward
        for name, net in nets.items()
        for forward in time_forwards(name, net, inputs, repetitions, rate)
    ]
    click.echo(table(FORWARD_COLUMNS, forwards) + "\n")
    totals = {stage.part: stage.seconds for stage in timed if stage.name == TOTAL}
    ratios = {effort: totals[effort] / totals[SIFT] for effort in get_args(Effort)}
    for effort, ratio in ratios.items():
        click.echo(f"effort {effort} over sift, in all: {ratio:.2f}")
    return {
        **facts,
        "stages": [asdict(stage) for stage in timed],
        "over_sift": ratios,
        "forwards": [asdict(forward) for forward in forwards],
    }
