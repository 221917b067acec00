"""The network's convolutions as ONNX graphs without weights; `python -m dgc_pose.runtime.export`.

Graphs for the pyramid, for what needs no weights, and for each decoder. What lies between them, the
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
    LEVELS,
    NATIVE,
    PRESETS,
    RESAMPLE,
    UPSAMPLE,
    WARP,
    WEIGHTS,
    decoder_graph,
)

_OPSET = 20
_CELLS = (8, 11)  # rows and columns at stride 16 of the example that a graph is traced with


class _Image(nn.Module):
    """The network's input (1, 3, H, W) from an image (H, W, 3) of 0 to 255, float32."""

    def __init__(self) -> None:
        super().__init__()
        scale = 1 / (255 * torch.tensor(DEVIATION))[:, None, None]
        self.register_buffer("scale", scale, persistent=False)
        shift = -255 * torch.tensor(MEAN)[:, None, None] * scale
        self.register_buffer("shift", shift, persistent=False)

    def forward(self, pixels: Tensor) -> Tensor:
        planes = pixels.permute(2, 0, 1)[None]
        return planes * cast(Tensor, self.scale) + cast(Tensor, self.shift)


class _Levels(nn.Module):
    """All levels of an image."""

    def __init__(self, net: DGCNet) -> None:
        super().__init__()
        self.image, self.pyramid = _Image(), net.pyramid

    def forward(self, pixels: Tensor) -> list[Tensor]:
        levels: list[Tensor] = self.pyramid(self.image(pixels))
        return levels


class _Native(nn.Module):
    """The coarsest three levels of an image, of unit length, channels last, fine to coarse."""

    def __init__(self, net: DGCNet) -> None:
        super().__init__()
        self.image, self.pyramid = _Image(), net.pyramid

    def forward(self, pixels: Tensor) -> list[Tensor]:
        levels = self.pyramid.coarse(self.image(pixels))
        return [F.normalize(level[0].permute(1, 2, 0), dim=-1) for level in levels]


class _Upsample(nn.Module):
    """A state at twice its size."""

    def forward(self, state: Tensor) -> Tensor:
        return upsample(state)


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
    """A level's state from the previous one at the same size."""

    def __init__(self, net: DGCNet, level: int) -> None:
        super().__init__()
        self.add_module(f"reg_{level}", net.get_submodule(f"reg_{level}"))

    def forward(self, features: list[Tensor], previous: Tensor, cell: Tensor) -> Tensor:
        (decoder,) = self.children()
        change: Tensor = decoder(torch.cat([*features, previous], 1))
        return previous + change * cell


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
    graphs: dict[str, list[str]] = {}

    def write(graph: str, module: nn.Module, given: Sequence[Any], shapes: Sequence[Any]) -> None:
        model = _graph(module.eval(), tuple(given), tuple(shapes))
        graphs[graph] = _without_weights(model, set(net.state_dict()))
        onnx.save_model(model, folder / graph)

    pixels, sides = torch.rand(STRIDE * rows, STRIDE * columns, 3), {0: STRIDE * h, 1: STRIDE * w}
    write(LEVELS, _Levels(net), [pixels], [sides])
    write(NATIVE, _Native(net), [pixels], [sides])
    features, state = torch.rand(1, 24, 12, 10), torch.rand(1, config.map_channels, 14, 18)
    c, d = (torch.export.Dim(name, min=1, max=4096) for name in "cd")
    given = [features, state]
    write(WARP, _Warp(net), given, [{1: c, 2: u, 3: v}, {2: h, 3: w}])
    write(UPSAMPLE, _Upsample(), [state], [{2: h, 3: w}])
    write(RESAMPLE, _Resample(), given, [{1: c, 2: u, 3: v}, {1: d, 2: h, 3: w}])
    for level in range(COARSEST + 1):
        channels = config.level_channels[level]
        window = config.decoder_inputs(level) - 2 * channels - config.map_channels
        given = [torch.rand(1, part, rows, columns) for part in (channels, channels, window)]
        cell = torch.rand(1, config.map_channels, 1, 1)
        write(
            decoder_graph(level),
            _Decoder(net, level),
            [given, torch.rand(1, config.map_channels, rows, columns), cell],
            [[{2: h, 3: w} for _ in given], {2: h, 3: w}, {}],
        )
    shapes = {key: value.shape for key, value in stored.state_dict().items()}
    shapes = {key: shape for key, shape in shapes.items() if not key.endswith(COUNTER)}
    text = json.dumps({"stored": shapes, "graphs": graphs}, indent=1)
    (folder / WEIGHTS).write_text(text + "\n", encoding="utf-8")


def _graph(module: nn.Module, given: tuple[Any, ...], shapes: tuple[Any, ...]) -> onnx.ModelProto:
    """The graph of a module, with its weights and without the exporter's notes."""
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
    del model.metadata_props[:]
    for node in model.graph.node:
        node.doc_string = ""
        del node.metadata_props[:]
    del model.graph.value_info[:]
    return model


def _without_weights(model: onnx.ModelProto, names: set[str]) -> list[str]:
    """Remove the values of the initializers that are among `names`, and return those."""
    removed = [tensor for tensor in model.graph.initializer if tensor.name in names]
    for tensor in removed:
        tensor.ClearField("raw_data")
        tensor.ClearField("float_data")
        tensor.data_location = onnx.TensorProto.EXTERNAL
        del tensor.external_data[:]
        # The engine hands the values over; a place must be named all the same.
        entry = tensor.external_data.add()
        entry.key, entry.value = "location", "weights"
    return [tensor.name for tensor in removed]


if __name__ == "__main__":
    for one in PRESETS:
        export(one, GRAPHS / one)
        print(one)
