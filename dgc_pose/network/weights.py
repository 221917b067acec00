"""Weights: our safetensors, the authors' checkpoints, and those shipped in the package."""

from __future__ import annotations

import hashlib
import json
import pickle
from importlib import resources
from pathlib import Path
from typing import Any

import torch
from safetensors import SafetensorError, safe_open
from safetensors.torch import save
from torch import Tensor

from dgc_pose.errors import InputError, WeightsError
from dgc_pose.files import replaced
from dgc_pose.network.config import DEFAULT_WEIGHTS, PRESETS, preset
from dgc_pose.network.net import DGCNet

DEFAULT = DEFAULT_WEIGHTS
_SUFFIX = ".safetensors"
_COUNTER = "num_batches_tracked"  # absent from checkpoints of torch 0.3, and unused here
_MASK = "matchability_net."


def shipped() -> list[str]:
    """Names of the weights inside the package."""
    folder = resources.files("dgc_pose") / "weights"
    if not folder.is_dir():
        return []
    return sorted(p.name[: -len(_SUFFIX)] for p in folder.iterdir() if p.name.endswith(_SUFFIX))


def load_network(weights: str | Path = DEFAULT, device: torch.device | str = "cpu") -> DGCNet:
    """A network with its weights, in evaluation mode and frozen.

    weights: a shipped name ("dgcm-lite"), a .safetensors of ours, or an authors' checkpoint (.pth;
    `dgc` or `dgcm` by its keys). Raises WeightsError, naming the file and the first keys that
    differ, if it is missing, unreadable or of another network.
    """
    path = _find(weights)
    name, state = _read(path)
    net = DGCNet(preset(name))
    _check(path, name, state, net.state_dict())
    net.load_state_dict({k: v.float() for k, v in state.items()}, strict=False)
    return net.eval().requires_grad_(False).to(device)


def save_weights(net: DGCNet, path: str | Path) -> None:
    """Write a network as safetensors in half precision, its preset's name in the header."""
    state = {
        key: value.detach().cpu().half().contiguous()
        for key, value in net.state_dict().items()
        if not key.endswith(_COUNTER)
    }
    with replaced(Path(path)) as temporary:
        # Not save_file, whose files only their owner may read.
        temporary.write_bytes(save(state, metadata={"preset": net.config.name}))


def fingerprint(net: DGCNet) -> str:
    """16 hexadecimal digits that identify the weights of a network."""
    digest = hashlib.sha256()
    for key, value in sorted(net.state_dict().items()):
        if not key.endswith(_COUNTER):
            digest.update(key.encode() + value.float().cpu().numpy().tobytes())
    return digest.hexdigest()[:16]


def load_checkpoint(path: Path, device: torch.device | str = "cpu") -> Any:
    """The content of a torch.save file of tensors and plain values. Raises WeightsError, with the
    path, for any other file."""
    try:
        return torch.load(path, map_location=device, weights_only=True)
    except pickle.UnpicklingError as error:
        # torch's own message advises to load the file as code: unsafe.
        raise WeightsError(f"{path}: not a checkpoint of tensors and plain values") from error
    except (RuntimeError, EOFError, OSError, ValueError, KeyError) as error:
        raise WeightsError(f"{path}: not a checkpoint that can be read ({_line(error)})") from error


def _find(weights: str | Path) -> Path:
    name = str(weights)
    if name in shipped():
        return Path(str(resources.files("dgc_pose") / "weights" / (name + _SUFFIX)))
    if name in PRESETS:
        raise WeightsError(
            f"no weights are shipped for {name} (there are: {', '.join(shipped()) or 'none'}); "
            f"give a file"
        )
    path = Path(weights)
    if not path.is_file():
        raise WeightsError(f"{path}: no such weights file, and none shipped of that name")
    return path


def _read(path: Path) -> tuple[str, dict[str, Tensor]]:
    if path.suffix == _SUFFIX:
        return _read_safetensors(path)
    return _read_checkpoint(path)


def _read_safetensors(path: Path) -> tuple[str, dict[str, Tensor]]:
    try:
        with safe_open(path, "pt") as file:
            metadata = file.metadata() or {}
            state = {key: file.get_tensor(key) for key in file.keys()}
    except (SafetensorError, OSError, json.JSONDecodeError) as error:
        raise WeightsError(f"{path}: not a safetensors file ({_line(error)})") from error
    name = metadata.get("preset", "")
    try:
        preset(name)
    except InputError:
        raise WeightsError(
            f"{path}: its header names no preset of ours ({name or 'nothing'})"
        ) from None
    return name, state


def _read_checkpoint(path: Path) -> tuple[str, dict[str, Tensor]]:
    content = load_checkpoint(path)
    state = content.get("state_dict", content) if isinstance(content, dict) else None
    if not isinstance(state, dict) or not all(isinstance(v, Tensor) for v in state.values()):
        raise WeightsError(f"{path}: holds no state_dict")
    state = {key.removeprefix("module."): value for key, value in state.items()}
    state = {key: value for key, value in state.items() if not key.endswith(_COUNTER)}
    has_mask = any(key.startswith(_MASK) for key in state)
    return "dgcm" if has_mask else "dgc", state


def _check(path: Path, name: str, state: dict[str, Tensor], wanted: dict[str, Tensor]) -> None:
    """Raise WeightsError if keys or shapes differ, naming the first ones."""
    expected = {key: value for key, value in wanted.items() if not key.endswith(_COUNTER)}
    missing = [key for key in expected if key not in state]
    unexpected = [key for key in state if key not in expected]
    reshaped = [
        f"{key} {tuple(state[key].shape)} instead of {tuple(value.shape)}"
        for key, value in expected.items()
        if key in state and state[key].shape != value.shape
    ]
    for what, keys in (("lacks", missing), ("has", unexpected), ("has", reshaped)):
        if keys:
            more = f" and {len(keys) - 3} more" if len(keys) > 3 else ""
            raise WeightsError(
                f"{path}: not weights of {name}: it {what} {', '.join(keys[:3])}{more}"
            )


def _line(error: Exception) -> str:
    return str(error).strip().splitlines()[0] if str(error).strip() else type(error).__name__
