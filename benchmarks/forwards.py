"""A network's pass over a pair: its multiply-adds, the machine's rate, and the ways to run it."""

from __future__ import annotations

import time
from collections.abc import Callable, Sequence
from dataclasses import dataclass

import numpy as np
import torch
from torch import Tensor
from torch.utils.flop_counter import FlopCounterMode

from dgc_pose.benchmarks.table import table
from dgc_pose.network.config import INPUT_SIZE
from dgc_pose.network.inference import for_inference
from dgc_pose.network.net import DGCNet

_MATRIX = 2048  # rows and columns of the matrix product that the machine's rate is taken from

_COLUMNS = {
    "network": "{0.network}",
    "way": "{0.way}",
    "ms": "{0.milliseconds:.1f}",
    "times faster": "{0.times_faster:.2f}",
    "over floor": "{0.over_floor:.2f}",
    "apart px": "{0.apart_px:.1e}",
}


@dataclass(frozen=True)
class Forward:
    """One way to run a network on a pair, 240 x 240."""

    network: str
    way: str
    seconds: float  # median over the repetitions
    times_faster: float  # than torch's eager pass: median of the ratios of each repetition
    over_floor: float  # its seconds over those of its multiply-adds at the machine's rate
    apart_px: float  # median distance of its map from the eager one's, pixels of 240 x 240

    @property
    def milliseconds(self) -> float:
        return 1000 * self.seconds


def multiply_adds(net: DGCNet) -> tuple[int, int]:
    """Multiply-adds of the convolutions for a pair: of both images' encoder, and of the decoders.

    Correlations are left out: they are hardly a hundredth.
    """
    image = torch.zeros(1, 3, INPUT_SIZE, INPUT_SIZE, device=next(net.parameters()).device)
    with torch.inference_mode():
        with FlopCounterMode(display=False) as encoder:
            features = net.features(image)
        with FlopCounterMode(display=False) as decoders:
            net.decode(features, features)
    counts = [
        int(counter.get_flop_counts()["Global"][torch.ops.aten.convolution]) // 2
        for counter in (encoder, decoders)
    ]
    return 2 * counts[0], counts[1]


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
    eager = "torch, eager"
    ways: dict[str, DGCNet] = {eager: net, "batch norm folded": for_inference(net)}
    ways["bfloat16"] = half
    total = sum(multiply_adds(net))
    seconds: dict[str, list[float]] = {way: [] for way in ways}
    rates = []
    with torch.inference_mode():
        maps = {way: variant(*images).maps[-1] for way, variant in ways.items()}
        for _ in range(repetitions):
            for way, variant in ways.items():
                start = time.perf_counter()
                variant(*images)
                seconds[way].append(time.perf_counter() - start)
            rates.append(rate())
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


def forwards_text(forwards: Sequence[Forward]) -> str:
    """The ways to run the networks as a table with aligned columns."""
    return table(_COLUMNS, forwards)
