"""The convolutions as ONNX graphs without weights; `python -m dgc_pose.training.export_graphs`.

There are graphs for the pyramid, for the steps without weights, and for each decoder. They name the
weights, which stay in the safetensors file: one set of graphs serves all weights of a preset.

Needs torch, onnx and onnxscript. Export the graphs again if the network of a preset changes;
tests/runtime/test_engines.py fails until then.
"""

import itertools
import json
from collections.abc import Callable
from pathlib import Path
from typing import Any

import onnx
import torch
import torch.nn.functional as F
from torch import Tensor, nn

from dgc_pose.network.config import COARSEST, DEFAULT_WEIGHTS, DEVIATION, MEAN, STRIDE, preset
from dgc_pose.network.efficientnet import EfficientPyramid, upsample
from dgc_pose.network.net import DGCNet
from dgc_pose.network.weights import COUNTER
from dgc_pose.runtime import engine as graphs
from dgc_pose.runtime.torch_engine import for_inference

_OPSET = 20
_CELLS = (8, 11)  # rows and columns at stride 16 of the example that graphs are traced with


class _Part(nn.Module):
    """A function of a part of a network and tensors; the part's weights keep their names."""

    def __init__(self, function: Callable[..., Any], **part: nn.Module) -> None:
        super().__init__()
        self.function = function
        for name, module in part.items():
            self.add_module(name, module)

    def forward(self, *arguments: Any) -> Any:
        return self.function(*self.children(), *arguments)


def _levels(pyramid: EfficientPyramid, pixels: Tensor) -> list[Tensor]:
    """All levels of an image (H, W, 3) of 0 to 255, float32."""
    return pyramid(_input(pixels))


def _native(pyramid: EfficientPyramid, pixels: Tensor) -> list[Tensor]:
    """The coarsest three levels of an image, unit length, channels last, fine to coarse."""
    levels = pyramid.coarse(_input(pixels))
    return [F.normalize(level[0].permute(1, 2, 0), dim=-1) for level in levels]


def _input(pixels: Tensor) -> Tensor:
    scale = 1 / (255 * torch.tensor(DEVIATION))[:, None, None]
    shift = -255 * torch.tensor(MEAN)[:, None, None] * scale
    return pixels.permute(2, 0, 1)[None] * scale + shift


def _decode(decoder: nn.Module, features: list[Tensor], previous: Tensor, cell: Tensor) -> Tensor:
    """A level's state from the previous level's state at the same size."""
    return previous + decoder(torch.cat([*features, previous], 1)) * cell


def export(folder: Path) -> None:
    """Write the graphs of the default preset into a folder."""
    config = preset(DEFAULT_WEIGHTS)
    stored = DGCNet(config).eval()
    net = for_inference(stored)
    net.to(memory_format=torch.contiguous_format)  # type: ignore[call-overload]
    weights = stored.state_dict()
    folder.mkdir(parents=True, exist_ok=True)
    weights_of: dict[str, list[str]] = {}

    def write(graph: str, module: nn.Module, inputs: list[Any], shapes: list[Any]) -> None:
        model = onnx_graph(module.eval(), tuple(inputs), (tuple(shapes),))
        weights_of[graph] = without_weights(model, set(net.state_dict()))
        onnx.save_model(model, folder / graph)

    def resample(features: Tensor, like: Tensor) -> Tensor:
        return F.interpolate(features, like.shape[2:], mode="bilinear")

    rows, columns = _CELLS
    c, d, h, w, u, v = (torch.export.Dim(name, min=1, max=4096) for name in "cdhwuv")
    pixels = torch.rand(STRIDE * rows, STRIDE * columns, 3)
    sides = {0: STRIDE * h, 1: STRIDE * w}
    write(graphs.LEVELS, _Part(_levels, pyramid=net.pyramid), [pixels], [sides])
    write(graphs.NATIVE, _Part(_native, pyramid=net.pyramid), [pixels], [sides])
    features = torch.rand(1, 24, 12, 10)
    state = torch.rand(1, config.map_channels, 14, 18)
    any_features = {1: c, 2: u, 3: v}
    pair = [features, state]
    write(graphs.WARP, _Part(net.warp), pair, [any_features, {2: h, 3: w}])
    write(graphs.UPSAMPLE, _Part(upsample), [state], [{2: h, 3: w}])
    write(graphs.RESAMPLE, _Part(resample), pair, [any_features, {1: d, 2: h, 3: w}])
    for level in range(COARSEST + 1):
        channels = config.level_channels[level]
        window = config.decoder_inputs(level) - 2 * channels - config.map_channels
        parts = [torch.rand(1, part, rows, columns) for part in (channels, channels, window)]
        previous = torch.rand(1, config.map_channels, rows, columns)
        write(
            f"reg_{level}.onnx",
            _Part(_decode, **{f"reg_{level}": net.get_submodule(f"reg_{level}")}),
            [parts, previous, torch.rand(1, config.map_channels, 1, 1)],
            [[{2: h, 3: w}] * len(parts), {2: h, 3: w}, {}],
        )
    shapes = {key: value.shape for key, value in weights.items() if not key.endswith(COUNTER)}
    text = json.dumps({"stored": shapes, "graphs": weights_of}, indent=1)
    (folder / graphs.WEIGHTS).write_text(text + "\n", encoding="utf-8")


def onnx_graph(
    module: nn.Module, inputs: tuple[Any, ...], shapes: tuple[Any, ...]
) -> onnx.ModelProto:
    """The graph of a module, with its weights and without the exporter's notes."""
    program = torch.onnx.export(
        module,
        inputs,
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
    parts = model.graph.node, model.graph.input, model.graph.output, model.graph.initializer
    for part in itertools.chain(*parts):
        del part.metadata_props[:]
    del model.graph.value_info[:]
    return model


def without_weights(model: onnx.ModelProto, names: set[str]) -> list[str]:
    """Remove the values of the initializers in `names`; return the names of those removed."""
    removed = [tensor for tensor in model.graph.initializer if tensor.name in names]
    for tensor in removed:
        tensor.ClearField("raw_data")
        tensor.ClearField("float_data")
        tensor.data_location = onnx.TensorProto.EXTERNAL
        del tensor.external_data[:]
        # The engine supplies the values, but ONNX requires a location.
        entry = tensor.external_data.add()
        entry.key = "location"
        entry.value = "weights"
    return [tensor.name for tensor in removed]


if __name__ == "__main__":
    export(graphs.GRAPHS)
