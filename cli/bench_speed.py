"""`dgc-pose bench-speed`: where the time of a pair goes."""

from __future__ import annotations

import json
from collections.abc import Mapping
from dataclasses import asdict
from pathlib import Path
from typing import get_args

import click
import cv2
import torch

from dgc_pose.benchmarks.forwards import forwards_text, matrix_rate, time_forwards
from dgc_pose.benchmarks.speed import (
    SIFT_TOTAL,
    TOTAL,
    Setup,
    bundled_setup,
    given_setup,
    stages,
    stages_text,
)
from dgc_pose.cli.guard import OutputFile
from dgc_pose.cli.options import RUNTIME_HELP, split_names
from dgc_pose.files.outputs import save_text, scratch_folder, staged
from dgc_pose.images.image import load_image
from dgc_pose.matchers import refined
from dgc_pose.matching import DEFAULT_WEIGHTS, load_dense_matcher
from dgc_pose.network.config import INPUT_SIZE, preset
from dgc_pose.network.net import DGCNet
from dgc_pose.network.weights import load_network
from dgc_pose.refinement import RefinementOptions
from dgc_pose.runtime.load import RuntimeName
from dgc_pose.runtime.onnx_engine import OnnxEngine
from dgc_pose.runtime.torch_engine import network_input


@click.command()
@click.argument("image1", required=False, type=click.Path(path_type=Path))
@click.argument("image2", required=False, type=click.Path(path_type=Path))
@click.argument("k", metavar="[K]", required=False)
@click.option("--weights", default=DEFAULT_WEIGHTS, show_default=True, help="Name or path.")
@click.option(
    "--forward",
    "networks",
    default="dgcm",
    show_default=True,
    help="Comma-separated presets whose forward passes, with random weights, are timed too.",
)
@click.option(
    "--repetitions",
    type=click.IntRange(1, 10**6),
    default=7,
    show_default=True,
    help="Their median counts.",
)
@click.option(
    "--threads",
    type=click.IntRange(1, 1024),
    help="Threads of torch and OpenCV; default: their own choice.",
)
@click.option(
    "--runtime",
    type=click.Choice(get_args(RuntimeName)),
    default="auto",
    show_default=True,
    help=RUNTIME_HELP,
)
@click.option(
    "--json",
    "json_path",
    type=OutputFile(),
    metavar="PATH",
    help="Write all figures as JSON.",
)
def bench_speed(
    image1: Path | None,
    image2: Path | None,
    k: str | None,
    weights: str,
    networks: str,
    repetitions: int,
    threads: int | None,
    runtime: RuntimeName,
    json_path: str | None,
) -> None:
    """Time the pipeline stage by stage, and the network's ways to run.

    Without images it takes the bundled pair, enlarged to 1600x1200.
    """
    with staged(json_path) as stage, scratch_folder() as folder:
        if threads is not None:
            torch.set_num_threads(threads)
            cv2.setNumThreads(threads)
        configs = {f"{name}, random": preset(name) for name in split_names(networks)}
        dense = load_dense_matcher(weights, device="cpu", runtime=runtime)
        pair = bundled_setup(folder) if image1 is None else given_setup(image1, image2, k)
        nets = {dense.name: load_network(weights)}
        for name, config in configs.items():
            torch.manual_seed(0)
            nets[name] = DGCNet(config).eval().requires_grad_(False)
        setup = Setup(*pair, dense, refined(dense, RefinementOptions()))
        data = _measure(setup, nets, repetitions)
        if json_path is not None:
            save_text(stage(json_path), json.dumps(data, indent=1) + "\n")


def _measure(setup: Setup, nets: Mapping[str, DGCNet], repetitions: int) -> dict[str, object]:
    """Measure, print, and return what is written as JSON."""
    images = [load_image(path) for path in (setup.path1, setup.path2)]
    facts = {
        "weights": setup.dense.name,
        "runtime": "onnx" if isinstance(setup.dense.engine, OnnxEngine) else "torch",
        "size": "x".join(map(str, images[0].size)),
        "repetitions": repetitions,
        "torch_threads": torch.get_num_threads(),
        "opencv_threads": cv2.getNumThreads(),
        "torch": torch.__version__,
    }
    click.echo(", ".join(f"{name} {value}" for name, value in facts.items()))
    found = stages(setup, repetitions, matrix_rate)
    click.echo("\n" + stages_text(found) + "\n")
    size, device = (INPUT_SIZE, INPUT_SIZE), torch.device("cpu")
    inputs = [network_input(image.pixels, size, device) for image in images]
    ways = [
        way
        for name, net in nets.items()
        for way in time_forwards(name, net, inputs, repetitions, matrix_rate)
    ]
    click.echo(forwards_text(ways) + "\n")
    seconds = {stage.name: stage.seconds for stage in found}
    ratio = seconds[SIFT_TOTAL] / seconds[TOTAL]
    click.echo(f"sift over dgc-pose, in all: {ratio:.2f}")
    return {
        **facts,
        "stages": [asdict(stage) for stage in found],
        "sift_over_dgc_pose": ratio,
        "forwards": [asdict(one) for one in ways],
    }
