"""ALIKED and LightGlue for `dgc-pose-lightglue`: graphs without weights, and the weights.

    python -m dgc_pose.training.export_lightglue RELEASED FOLDER

RELEASED is the folder of the released aliked-n16.pth and aliked_lightglue.pth. Needs torch, onnx
and onnxscript.
"""

import json
import sys
from pathlib import Path
from typing import Any

import numpy as np
import onnx
import torch
from safetensors.numpy import save_file
from torch import nn

from dgc_pose.matching import lightglue
from dgc_pose.network.weights import load_checkpoint
from dgc_pose.training.aliked import Aliked, aliked_state
from dgc_pose.training.export_graphs import onnx_graph, without_weights
from dgc_pose.training.lightglue import WIDTH, Layer, head_state, layer_state

_ALIKED = "aliked-n16.pth"
_LIGHTGLUE = "aliked_lightglue.pth"


def export(released: Path, folder: Path) -> None:
    """Write the graphs and the weights into a folder, from the folder with the released ones.
    Raises WeightsError if these cannot be read."""
    folder.mkdir(parents=True, exist_ok=True)
    given = {name: load_checkpoint(released / name) for name in (_ALIKED, _LIGHTGLUE)}
    parts = {"aliked": aliked_state(given[_ALIKED]), "": head_state(given[_LIGHTGLUE])}
    parts |= {f"layers.{i}": layer_state(given[_LIGHTGLUE], i) for i in range(lightglue.LAYERS)}
    weights = {
        f"{part}.{key}".removeprefix("."): value.numpy().astype(np.float16)
        for part, state in parts.items()
        for key, value in state.items()
    }
    h, w, n, m = (torch.export.Dim(name, min=2, max=4096) for name in "hwnm")
    _write(
        folder / lightglue.ALIKED,
        Aliked(),
        [torch.rand(96, 128, 3)],
        [{0: 32 * h, 1: 32 * w}],
    )
    sides = [(20, WIDTH), (30, WIDTH), (20, 32), (20, 32), (30, 32), (30, 32)]
    _write(
        folder / lightglue.LAYER,
        Layer(),
        [torch.rand(size) for size in sides],
        [{0: side} for side in (n, m, n, n, m, m)],
    )
    ordered = {key: np.ascontiguousarray(weights[key]) for key in sorted(weights)}
    save_file(ordered, folder / lightglue.WEIGHTS)
    shapes = {key: value.shape for key, value in ordered.items()}
    (folder / lightglue.SHAPES).write_text(json.dumps(shapes, indent=1) + "\n", encoding="utf-8")


def _write(path: Path, module: nn.Module, inputs: list[Any], shapes: list[Any]) -> None:
    for parameter in module.parameters():
        nn.init.uniform_(parameter)  # the exporter joins equal ones
    model = onnx_graph(module.eval(), tuple(inputs), (*shapes,))
    names = set(module.state_dict())
    removed = without_weights(model, names)
    assert set(removed) == names, names - set(removed)
    onnx.save_model(model, path)


if __name__ == "__main__":
    if len(sys.argv) != 3:
        sys.exit(__doc__)
    export(Path(sys.argv[1]), Path(sys.argv[2]))
