"""A network's pass over a pair: its multiply-adds, the machine's rate, and the ways to run it."""

from __future__ import annotations

import math
import time
from collections.abc import Callable, Iterator, Sequence
from contextlib import contextmanager
from dataclasses import dataclass

import numpy as np
import torch
from torch import Tensor, nn

from dgc_pose.benchmarks.table import aligned
from dgc_pose.network.config import INPUT_SIZE
from dgc_pose.network.inference import for_inference
from dgc_pose.network.net import DGCNet

_MATRIX = 2048  # rows and columns of the matrix product that the machine's rate is taken from


@dataclass(frozen=True)
class Forward:
    """One way to run a network on a pair, 240 x 240."""

    network: str
    way: str
    seconds: float  # median over the repetitions
    times_faster: float  # than torch's eager pass: median of the ratios of each repetition
    over_floor: float  # its seconds over those of its multiply-adds at the machine's rate
    apart_px: float  # median distance of its map from the eager one's, pixels of 240 x 240


def multiply_adds(net: DGCNet) -> tuple[int, int]:
    """Multiply-adds of the convolutions for a pair: of both images' encoder, and of the decoders.

    Correlations are left out: they are hardly a hundredth.
    """
    parameter = next(net.parameters())
    image = torch.zeros(1, 3, INPUT_SIZE, INPUT_SIZE, device=parameter.device)
    with torch.inference_mode():
        with _counted(net) as encoder:
            features = net.features(image)
        with _counted(net) as decoders:
            net.decode(features, features)
    return 2 * sum(encoder), sum(decoders)


@contextmanager
def _counted(net: DGCNet) -> Iterator[list[int]]:
    """Multiply-adds of each convolution that runs inside the block."""
    found: list[int] = []

    def count(layer: nn.Module, inputs: tuple[Tensor, ...], output: Tensor) -> None:
        assert isinstance(layer, nn.Conv2d)
        found.append(output.numel() * layer.in_channels * math.prod(layer.kernel_size))

    hooks = [m.register_forward_hook(count) for m in net.modules() if isinstance(m, nn.Conv2d)]
    try:
        yield found
    finally:
        for hook in hooks:
            hook.remove()


def matrix_rate() -> float:
    """Multiply-adds a second of a large matrix product in single precision, on this machine."""
    matrix = torch.ones(_MATRIX, _MATRIX)
    start = time.perf_counter()
    torch.mm(matrix, matrix)
    return _MATRIX**3 / (time.perf_counter() - start)


def time_forwards(
    name: str, net: DGCNet, images: Sequence[Tensor], repetitions: int, rate: Callable[[], float]
) -> list[Forward]:
    """The ways to run a network on two images (1, 3, 240, 240), the eager one first."""
    half = for_inference(net)
    half.half_precision = True
    ways: dict[str, DGCNet] = {
        "torch, eager": net,
        "batch norm folded": for_inference(net),
        "bfloat16": half,
    }
    total = sum(multiply_adds(net))
    seconds: dict[str, list[float]] = {way: [] for way in ways}
    rates = []
    with torch.inference_mode():
        maps = {way: one(*images).maps[-1] for way, one in ways.items()}
        for _ in range(repetitions):
            for way, one in ways.items():
                start = time.perf_counter()
                one(*images)
                seconds[way].append(time.perf_counter() - start)
            rates.append(rate())
    eager, *_ = ways
    floor = total / float(np.median(rates))
    return [
        Forward(
            name,
            way,
            float(np.median(taken)),
            float(np.median(np.divide(seconds[eager], taken))),
            float(np.median(taken)) / floor,
            float((maps[way] - maps[eager]).norm(dim=1).median()) * INPUT_SIZE / 2,
        )
        for way, taken in seconds.items()
    ]


def forwards_text(found: Sequence[Forward]) -> str:
    """The ways to run the networks as a table with aligned columns."""
    rows = [("network", "way", "ms", "times faster", "over floor", "apart px")]
    for one in found:
        ratios = f"{one.times_faster:.2f}", f"{one.over_floor:.2f}", f"{one.apart_px:.1e}"
        rows.append((one.network, one.way, milliseconds(one.seconds), *ratios))
    return aligned(rows)


def milliseconds(seconds: float) -> str:
    """Seconds as milliseconds with one decimal."""
    return f"{1000 * seconds:.1f}"
