"""The ONNX graphs: of which presets there are some, where they lie, and which weights each has."""

from __future__ import annotations

from collections.abc import Mapping
from pathlib import Path

import numpy as np

PRESETS = ("dgcm-lite", "dgcm-lite0")
GRAPHS = Path(__file__).parent / "graphs"  # one folder a preset
PYRAMID, WARP, RESAMPLE = "pyramid.onnx", "warp.onnx", "resample.onnx"
SHAPES = "weights.json"  # beside the graphs: the shape of each stored weight, by name


def decoder_graph(level: int) -> str:
    """The file of a level's decoder."""
    return f"reg_{level}.onnx"


def own_weights(graph: str, weights: Mapping[str, np.ndarray]) -> dict[str, np.ndarray]:
    """Those of a network's weights that a graph has: their names begin with the graph's."""
    prefix = graph.removesuffix("onnx")
    return {name: value for name, value in weights.items() if name.startswith(prefix)}
