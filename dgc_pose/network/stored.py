"""Weights as stored, without torch: shipped ones by name, and safetensors files of ours."""

from __future__ import annotations

import hashlib
import os
from collections.abc import Iterable, Iterator, Mapping, Sequence
from contextlib import contextmanager
from pathlib import Path

import numpy as np
from safetensors import safe_open

from dgc_pose.errors import WeightsError
from dgc_pose.network.config import PRESETS
from dgc_pose.system.files import open_file, read_as

SUFFIX = ".safetensors"
_FOLDER = Path(__file__).parents[1] / "weights"
COUNTER = "num_batches_tracked"  # absent from checkpoints of torch 0.3, and unused here
_BATCH_NORM_EPSILON = 1e-5


def shipped() -> list[str]:
    """Names of the weights inside the package."""
    return sorted(path.stem for path in _FOLDER.glob(f"*{SUFFIX}"))


def find_weights(weights: str | os.PathLike[str]) -> Path:
    """The file of shipped weights by name, or of a path. Raises WeightsError if there is none."""
    name = os.fspath(weights)
    if name in shipped():
        return _FOLDER / (name + SUFFIX)
    if name in PRESETS:
        known = ", ".join(shipped()) or "none"
        raise WeightsError(f"no weights are shipped for {name} (there are: {known}); give a file")
    path = Path(weights)
    if "\0" in name or not path.exists():
        raise WeightsError(f"{path}: no such weights file, and none shipped of that name")
    return path


def read_safetensors(path: Path) -> tuple[str, dict[str, np.ndarray]]:
    """The preset's name, and the arrays of a file of ours.

    Raises WeightsError, naming the file, if it is none.
    """
    metadata, state = read_tensors(path)
    name = metadata.get("preset", "")
    if name not in PRESETS:
        raise WeightsError(f"{path}: its header names no preset of ours ({name or 'nothing'})")
    return name, state


def read_tensors(path: Path) -> tuple[dict[str, str], dict[str, np.ndarray]]:
    """The header and the arrays of any safetensors file. Raises WeightsError, with the path, for
    any other file."""
    with reading("a safetensors file", path), safe_open(path, "np") as file:
        return file.metadata() or {}, {key: file.get_tensor(key) for key in file.keys()}


@contextmanager
def reading(what: str, path: Path) -> Iterator[None]:
    """`read_as`, of a regular file, where an OSError is a WeightsError, too."""
    try:
        open_file(path, WeightsError).close()
        with read_as(what, path, WeightsError):
            yield
    except OSError as error:
        raise WeightsError(f"{path} cannot be read: {error.strerror}") from error


def check_state(
    path: Path, name: str, state: Mapping[str, np.ndarray], wanted: Mapping[str, Sequence[int]]
) -> None:
    """Raise WeightsError, naming the first such key, if keys or shapes of the weights `name` are
    not those wanted, or values are not finite real floats."""
    expected = {key: tuple(shape) for key, shape in wanted.items() if not key.endswith(COUNTER)}
    for key in [*expected, *state]:
        value, shape = state.get(key), expected.get(key)
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
        raise WeightsError(f"{path}: not weights of {name}: it {fault}")


def fingerprint(state: Iterable[tuple[str, np.ndarray]]) -> str:
    """16 hexadecimal digits that identify weights, in single precision, before they are folded."""
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
