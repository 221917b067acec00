"""Weights: shipped in the package by name, our safetensors files, and the authors' checkpoints.
torch is imported only where it is needed."""

from __future__ import annotations

import hashlib
import os
import pickle
import zipfile
from collections.abc import Iterable, Iterator, Mapping, Sequence
from contextlib import contextmanager
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np
from safetensors import safe_open

from dgc_pose.errors import ArgumentName, InputError, WeightsError
from dgc_pose.network.config import DEFAULT_WEIGHTS, PRESETS, preset
from dgc_pose.system.files import open_file, read_as

if TYPE_CHECKING:
    import torch

    from dgc_pose.network.net import DGCNet

SUFFIX = ".safetensors"
_FOLDER = Path(__file__).parents[1] / "weights"
COUNTER = "num_batches_tracked"  # absent from checkpoints of torch 0.3, and unused here
_BATCH_NORM_EPSILON = 1e-5


def shipped() -> list[str]:
    """Names of the weights inside the package."""
    return sorted(path.stem for path in _FOLDER.glob(f"*{SUFFIX}"))


def find_weights(weights: str | os.PathLike[str]) -> Path:
    """The file of weights, by a shipped name or a path. Raises WeightsError if it is missing."""
    name = os.fspath(weights)
    if name in shipped():
        return _FOLDER / (name + SUFFIX)
    if name in PRESETS:
        known = ", ".join(shipped()) or "none"
        raise WeightsError(f"no weights are shipped for {name} (shipped: {known}): give a file")
    path = Path(weights)
    if "\0" in name or not path.exists():
        raise WeightsError(path, "is not a file, and no weights of that name are shipped")
    return path


def read_safetensors(path: Path) -> tuple[str, dict[str, np.ndarray]]:
    """The name of the preset and the arrays in a file of ours. Raises WeightsError for others."""
    metadata, state = read_tensors(path)
    name = metadata.get("preset", "")
    if name not in PRESETS:
        raise WeightsError(path, f"has a header without a known preset ({name or 'nothing'})")
    return name, state


def read_tensors(path: Path) -> tuple[dict[str, str], dict[str, np.ndarray]]:
    """The header and the arrays of any safetensors file. Raises WeightsError, with the path, for
    any other file."""
    with reading("a safetensors file", path), safe_open(path, "np") as file:
        return file.metadata() or {}, {key: file.get_tensor(key) for key in file.keys()}


@contextmanager
def reading(what: str, path: Path) -> Iterator[None]:
    """As `read_as`, for a regular file; turns an OSError into a WeightsError, too."""
    try:
        open_file(path, WeightsError).close()
        with read_as(what, path, WeightsError):
            yield
    except OSError as error:
        raise WeightsError(path, f"cannot be read: {error.strerror}") from error


def check_state(
    path: Path, name: str, state: Mapping[str, np.ndarray], wanted: Mapping[str, Sequence[int]]
) -> None:
    """Raise WeightsError, naming the first faulty key, if keys or shapes of the weights `name`
    differ from `wanted`, or if values are not finite real floats."""
    expected = {key: tuple(shape) for key, shape in wanted.items() if not key.endswith(COUNTER)}
    for key in [*expected, *state]:
        value = state.get(key)
        shape = expected.get(key)
        if value is None:
            fault = f"lacks {key}"
        elif value.shape != shape:
            fault = f"has {key} {value.shape}" + (f" instead of {shape}" if shape else "")
        elif value.dtype.kind != "f":
            fault = f"has {key} of {value.dtype}, not real floats"
        elif not np.isfinite(value).all():
            fault = f"has {key} with values that are not finite"
        else:
            continue
        raise WeightsError(path, f"does not contain the weights of {name}: it {fault}")


def fingerprint(state: Iterable[tuple[str, np.ndarray]]) -> str:
    """16 hexadecimal digits that identify weights, from their single-precision, unfolded values."""
    digest = hashlib.sha256()
    for key, value in sorted(state):
        if not key.endswith(COUNTER):
            digest.update(key.encode() + value.astype(np.float32).tobytes())
    return digest.hexdigest()[:16]


def folded(state: Mapping[str, np.ndarray]) -> dict[str, np.ndarray]:
    """Weights in single precision, each batch norm folded into the convolution before it."""
    weights = {key: value.astype(np.float32) for key, value in state.items()}
    for key in [key for key in weights if key.endswith(".running_mean")]:
        norm, _ = key.rsplit(".", 1)
        parent, index = norm.rsplit(".", 1)
        convolution = f"{parent}.{int(index) - 1}"
        mean, variance, scale, shift = (
            weights.pop(f"{norm}.{part}")
            for part in ("running_mean", "running_var", "weight", "bias")
        )
        factor = scale / np.sqrt(variance + np.float32(_BATCH_NORM_EPSILON))
        weights[f"{convolution}.weight"] *= factor[:, None, None, None]
        bias = weights[f"{convolution}.bias"]
        weights[f"{convolution}.bias"] = (bias - mean) * factor + shift
    return weights


def load_network(
    weights: str | Path = DEFAULT_WEIGHTS, device: torch.device | str = "cpu"
) -> DGCNet:
    """A network with its weights, in evaluation mode and frozen.

    weights: a shipped name ("dgcm-lite0"), our .safetensors, or a checkpoint of the authors (.pth;
    `dgc` or `dgcm` by its keys). Raises WeightsError, naming the file and the first key that
    differs, if the file is missing, unreadable or of another network.
    """
    import torch

    from dgc_pose.network.net import DGCNet

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
    """The torch device of that name; "auto" is a CUDA device if there is one, else the CPU. Raises
    InputError for an unknown name or a missing device."""
    import torch

    if name == "auto":
        return torch.device("cuda" if torch.cuda.is_available() else "cpu")
    try:
        device = torch.device(name)
        known = device.type in ("cpu", "cuda")
    except RuntimeError:
        known = False
    if not known:
        raise InputError(ArgumentName("device"), f"must be auto, cpu, cuda or cuda:N, not '{name}'")
    if device.type == "cuda" and not torch.cuda.is_available():
        raise InputError(ArgumentName("device"), f"{name}: no CUDA device is available here")
    return device


def load_checkpoint(path: Path, device: torch.device | str = "cpu") -> Any:
    """The content of a torch.save file of tensors and plain values. Raises WeightsError, with the
    path, for any other file."""
    import torch

    with reading("a checkpoint", path):
        if zipfile.is_zipfile(path):
            with zipfile.ZipFile(path) as archive:
                # A compressed archive could need any amount of memory; torch does not compress.
                if any(info.compress_type != zipfile.ZIP_STORED for info in archive.infolist()):
                    raise WeightsError(path, "is not a torch checkpoint: its archive is compressed")
        try:
            return torch.load(path, map_location=device, weights_only=True)
        except pickle.UnpicklingError as error:
            # torch's own message advises to load the file as code: unsafe.
            what = "is not a checkpoint of tensors and plain values"
            raise WeightsError(path, what) from error


def read_state(path: Path) -> dict[str, np.ndarray]:
    """The arrays of a .safetensors, or of a checkpoint's state_dict, whatever their keys. Raises
    WeightsError for any other file."""
    if path.suffix == SUFFIX:
        return read_tensors(path)[1]
    import torch

    content = load_checkpoint(path)
    state = content.get("state_dict", content) if isinstance(content, dict) else None
    if not isinstance(state, dict) or not all(
        isinstance(key, str) and isinstance(value, torch.Tensor) for key, value in state.items()
    ):
        raise WeightsError(path, "contains no state_dict")
    with reading("weights", path):  # NumPy cannot hold every tensor, e.g. sparse ones
        return {k: (v.float() if v.is_floating_point() else v).numpy() for k, v in state.items()}
