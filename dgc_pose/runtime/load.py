"""Which engine runs given weights: ONNX Runtime where it can, otherwise torch."""

import shutil
from pathlib import Path
from typing import Literal

from dgc_pose.errors import InputError, is_installed, require
from dgc_pose.network.config import DEFAULT_WEIGHTS
from dgc_pose.network.stored import SUFFIX, find_weights
from dgc_pose.runtime.engine import Engine

RuntimeName = Literal["auto", "onnx", "torch"]
DEVICE_HELP = "auto, cpu, cuda or cuda:N."
RUNTIME_HELP = (
    "onnx: ONNX Runtime, on the CPU; torch; auto: onnx for dgcm-lite0 on the CPU, else torch."
)
_DRIVERS = ("/dev/nvidiactl", "/dev/kfd", "/dev/dxg")  # of a graphics card, on Linux and in WSL


def load_engine(
    weights: str | Path = DEFAULT_WEIGHTS,
    *,
    device: str = "auto",
    runtime: RuntimeName = "auto",
    half_precision: bool = False,
) -> Engine:
    """An engine of shipped weights by name, or of those of a file (see `network.weights`).

    device: "auto", "cpu" or "cuda". runtime: "onnx" runs weights of the presets with graphs on the
    CPU and never imports torch; "torch" runs all; "auto" is ONNX Runtime for shipped weights
    that have graphs, on the CPU, and wherever torch is not installed. half_precision: convolutions
    in bfloat16, torch alone.

    Raises WeightsError if the weights cannot be loaded, InputError if there is no such device, or
    if the runtime is not installed or cannot do what is asked for.
    """
    path = find_weights(weights)
    if runtime == "auto":
        runtime = "torch" if half_precision else default_runtime(weights, device)
    if runtime == "onnx":
        if half_precision or device not in ("auto", "cpu"):
            asked = "in half_precision" if half_precision else f"on {device}"
            raise InputError(f"ONNX Runtime runs on the CPU, not {asked}: choose torch")
        from dgc_pose.runtime.onnx_engine import OnnxEngine

        return OnnxEngine(path)
    require({"the runtime torch" if path.suffix == SUFFIX else path.name: "torch"})
    from dgc_pose.network.weights import choose_device, load_network
    from dgc_pose.runtime.torch_engine import TorchEngine

    net = load_network(path, choose_device(device))
    net.half_precision = half_precision
    return TorchEngine(net)


def default_runtime(weights: str | Path = DEFAULT_WEIGHTS, device: str = "auto") -> RuntimeName:
    """The runtime that "auto" is here for weights. Raises as `find_weights` does."""
    if find_weights(weights).suffix != SUFFIX or device not in ("auto", "cpu"):
        return "torch"
    if not is_installed("torch"):
        return "onnx"
    shipped = str(weights) == DEFAULT_WEIGHTS
    return "onnx" if shipped and device_type(device) == "cpu" else "torch"


def device_type(name: str) -> str:
    """Where the device of that name is, "cpu" or "cuda"; "auto" is a GPU if torch can use one.

    Imports torch only if it is asked for a GPU, or there is a GPU's driver. Raises InputError for
    an unknown name or a missing device.
    """
    if name == "cpu" or (name == "auto" and not (is_installed("torch") and _may_have_gpu())):
        return "cpu"
    require({f"device {name}": "torch"})
    from dgc_pose.network.weights import choose_device

    return choose_device(name).type


def _may_have_gpu() -> bool:
    return shutil.which("nvidia-smi") is not None or any(Path(path).exists() for path in _DRIVERS)
