"""The network's convolutions as ONNX graphs without weights; `python -m dgc_pose.runtime.export`.

One graph for the pyramid, one that warps, one for each decoder. What lies between them, the
correlations and the consensus, is NumPy (`onnx_engine.py`). The weights stay in the safetensors
file: the graphs name them, and the engine hands them over by name. So a graph is some kilobytes, is
made once for a preset, and serves all weights of it.

Needs torch, onnx and onnxscript. The graphs are to be made anew if the network of a preset changes;
tests/runtime/test_onnx_engine.py fails until they are.
"""

from __future__ import annotations

import json
from collections.abc import Sequence
from pathlib import Path
from typing import Any, cast

import onnx
import torch
import torch.nn.functional as F
from torch import Tensor, nn

from dgc_pose.network.config import COARSEST, STRIDE, preset
from dgc_pose.network.constants import DEVIATION, MEAN
from dgc_pose.network.inference import for_inference
from dgc_pose.network.net import DGCNet, upsample
from dgc_pose.network.stored import COUNTER
from dgc_pose.runtime.graphs import (
    GRAPHS,
    PRESETS,
    PYRAMID,
    RESAMPLE,
    SHAPES,
    WARP,
    decoder_graph,
)

_OPSET = 20
_CELLS = (8, 11)  # rows and columns at stride 16 of the example that a graph is traced with


class _Pyramid(nn.Module):
    """All levels of an image, and the coarser three of unit length, channels last."""

    def __init__(self, net: DGCNet) -> None:
        super().__init__()
        self.pyramid = net.pyramid
        self.register_buffer("mean", 255 * torch.tensor(MEAN), persistent=False)
        self.register_buffer("deviation", 255 * torch.tensor(DEVIATION), persistent=False)

    def forward(self, pixels: Tensor) -> tuple[Tensor, ...]:
        image = (pixels - cast(Tensor, self.mean)) / cast(Tensor, self.deviation)
        levels = self.pyramid(image.permute(2, 0, 1)[None])
        unit = [F.normalize(level[0].permute(1, 2, 0), dim=-1) for level in levels[2:]]
        return (*levels, *unit)


class _Warp(nn.Module):
    """Source features at the points of a map."""

    def __init__(self, net: DGCNet) -> None:
        super().__init__()
        self.align_corners = net.config.align_corners

    def forward(self, source: Tensor, state: Tensor) -> Tensor:
        grid = state[:, :2].movedim(1, -1)
        return F.grid_sample(source, grid, align_corners=self.align_corners)


class _Resample(nn.Module):
    """Features resampled to the grid of others."""

    def forward(self, features: Tensor, like: Tensor) -> Tensor:
        return F.interpolate(features, like.shape[2:], mode="bilinear")


class _Decoder(nn.Module):
    """A level's state from the previous one; the state, and twice its size for the next level."""

    def __init__(self, net: DGCNet, level: int) -> None:
        super().__init__()
        self.add_module(f"reg_{level}", net.get_submodule(f"reg_{level}"))

    def forward(self, features: list[Tensor], previous: Tensor, cell: Tensor) -> list[Tensor]:
        (decoder,) = self.children()
        state = previous + decoder(torch.cat([*features, previous], 1)) * cell
        return [state, upsample(state)]


def export(name: str, folder: Path) -> None:
    """Write the graphs of a preset into a folder."""
    config = preset(name)
    stored = DGCNet(config).eval()
    net = for_inference(stored)
    net.to(memory_format=torch.contiguous_format)  # type: ignore[call-overload]
    rows, columns = _CELLS
    h, w = (torch.export.Dim(side, min=1, max=4096) for side in "hw")
    u, v = (torch.export.Dim(side, min=1, max=4096) for side in "uv")
    folder.mkdir(parents=True, exist_ok=True)
    shapes = {key: value.shape for key, value in stored.state_dict().items()}
    shapes = {key: shape for key, shape in shapes.items() if not key.endswith(COUNTER)}
    (folder / SHAPES).write_text(json.dumps(shapes, indent=0) + "\n", encoding="utf-8")

    def write(graph: str, module: nn.Module, given: Sequence[Any], shapes: Sequence[Any]) -> None:
        names = set(net.state_dict())
        _write(folder / graph, module.eval(), tuple(given), tuple(shapes), names)

    write(
        PYRAMID,
        _Pyramid(net),
        [torch.rand(STRIDE * rows, STRIDE * columns, 3)],
        [{0: STRIDE * h, 1: STRIDE * w}],
    )
    features, state = torch.rand(1, 24, 12, 10), torch.rand(1, config.map_channels, 14, 18)
    c, d = (torch.export.Dim(name, min=1, max=4096) for name in "cd")
    given = [features, state]
    write(WARP, _Warp(net), given, [{1: c, 2: u, 3: v}, {2: h, 3: w}])
    write(RESAMPLE, _Resample(), given, [{1: c, 2: u, 3: v}, {1: d, 2: h, 3: w}])
    for level in range(COARSEST + 1):
        inputs = config.decoder_inputs(level) - config.map_channels
        parts = [inputs]
        radius = config.decoders[level].local_radius
        if radius is not None:
            own = config.level_channels[level]
            parts = [own, own, (2 * radius + 1) ** 2]
        given = [torch.rand(1, part, rows, columns) for part in parts]
        cell = torch.rand(1, config.map_channels, 1, 1)
        write(
            decoder_graph(level),
            _Decoder(net, level),
            [given, torch.rand(1, config.map_channels, rows, columns), cell],
            [[{2: h, 3: w} for _ in given], {2: h, 3: w}, {}],
        )


def _write(
    path: Path, module: nn.Module, given: tuple[Any, ...], shapes: tuple[Any, ...], names: set[str]
) -> None:
    program = torch.onnx.export(
        module,
        given,
        dynamo=True,
        opset_version=_OPSET,
        dynamic_shapes=shapes,
        optimize=True,
        verbose=False,
    )
    assert program is not None
    model = program.model_proto
    for tensor in model.graph.initializer:
        if tensor.name in names:
            _without_values(tensor)
    del model.metadata_props[:]
    for node in model.graph.node:
        node.doc_string = ""
        del node.metadata_props[:]
    del model.graph.value_info[:]
    onnx.save_model(model, path)


def _without_values(tensor: onnx.TensorProto) -> None:
    """An initializer whose values the engine hands over."""
    tensor.ClearField("raw_data")
    tensor.ClearField("float_data")
    tensor.data_location = onnx.TensorProto.EXTERNAL
    del tensor.external_data[:]
    entry = tensor.external_data.add()
    entry.key, entry.value = "location", "weights"


if __name__ == "__main__":
    for one in PRESETS:
        export(one, GRAPHS / one)
        print(one)
