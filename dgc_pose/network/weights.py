"""Weights: our safetensors, the authors' checkpoints, and those shipped in the package."""

import pickle
import zipfile
from pathlib import Path
from typing import Any

import numpy as np
import torch
from torch import Tensor

from dgc_pose.errors import InputError, WeightsError
from dgc_pose.network.config import DEFAULT_WEIGHTS, preset
from dgc_pose.network.net import DGCNet
from dgc_pose.network.stored import (
    COUNTER,
    SUFFIX,
    check_state,
    find_weights,
    read_safetensors,
    read_tensors,
    reading,
)


def load_network(
    weights: str | Path = DEFAULT_WEIGHTS, device: torch.device | str = "cpu"
) -> DGCNet:
    """A network with its weights, in evaluation mode and frozen.

    weights: a shipped name ("dgcm-lite0"), a .safetensors of ours, or an authors' checkpoint (.pth;
    `dgc` or `dgcm` by its keys). Raises WeightsError, naming the file and the first key that
    differs, if it is missing, unreadable or of another network.
    """
    path = find_weights(weights)
    if path.suffix == SUFFIX:
        name, state = read_safetensors(path)
    else:
        stored = read_state(path).items()
        state = {k.removeprefix("module."): v for k, v in stored if not k.endswith(COUNTER)}
        name = "dgcm" if any(key.startswith("matchability_net.") for key in state) else "dgc"
    net = DGCNet(preset(name))
    check_state(path, name, state, {key: value.shape for key, value in net.state_dict().items()})
    tensors = {key: torch.from_numpy(value.astype(np.float32)) for key, value in state.items()}
    net.load_state_dict(tensors, strict=False)
    return net.eval().requires_grad_(False).to(device)


def choose_device(name: str = "auto") -> torch.device:
    """The torch device of that name; "auto" is a CUDA device if there is one, else the CPU.

    Raises InputError for an unknown name or a missing device.
    """
    if name == "auto":
        return torch.device("cuda" if torch.cuda.is_available() else "cpu")
    try:
        device = torch.device(name)
        known = device.type in ("cpu", "cuda")
    except RuntimeError:
        known = False
    if not known:
        raise InputError(f"device must be auto, cpu, cuda or cuda:N, not '{name}'")
    if device.type == "cuda" and not torch.cuda.is_available():
        raise InputError(f"device {name}: no CUDA device is available here")
    return device


def load_checkpoint(path: Path, device: torch.device | str = "cpu") -> Any:
    """The content of a torch.save file of tensors and plain values. Raises WeightsError, with the
    path, for any other file."""
    with reading("a checkpoint", path):
        if zipfile.is_zipfile(path):
            with zipfile.ZipFile(path) as archive:
                # A packed one could need any amount of memory; torch packs none.
                if any(info.compress_type != zipfile.ZIP_STORED for info in archive.infolist()):
                    raise WeightsError(f"{path}: not a checkpoint of torch: its archive is packed")
        try:
            return torch.load(path, map_location=device, weights_only=True)
        except pickle.UnpicklingError as error:
            # torch's own message advises to load the file as code: unsafe.
            what = "not a checkpoint of tensors and plain values"
            raise WeightsError(f"{path}: {what}") from error


def read_state(path: Path) -> dict[str, np.ndarray]:
    """The arrays of a .safetensors, or of a checkpoint's state_dict, whatever their keys.

    Raises WeightsError, with the path, for any other file.
    """
    if path.suffix == SUFFIX:
        return read_tensors(path)[1]
    content = load_checkpoint(path)
    state = content.get("state_dict", content) if isinstance(content, dict) else None
    if not isinstance(state, dict) or not all(
        isinstance(key, str) and isinstance(value, Tensor) for key, value in state.items()
    ):
        raise WeightsError(f"{path}: holds no state_dict")
    with reading("weights", path):  # NumPy cannot hold every tensor, a sparse one
        return {k: (v.float() if v.is_floating_point() else v).numpy() for k, v in state.items()}
