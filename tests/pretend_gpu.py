"""A simulated device: its tensors hold real numbers, and do not mix with those of the CPU.

It stands in for a GPU where there is none. What runs on it and agrees with the CPU mixes no devices
and leaves no tensor behind; how often the processor would have to wait for the GPU is counted. The
kernels, bfloat16 and the time they take are a GPU's own matter.
"""

from __future__ import annotations

import contextlib
import traceback
from collections import Counter
from collections.abc import Iterator
from pathlib import Path
from typing import Any
from unittest.mock import patch

import torch
from torch import Tensor
from torch.utils._python_dispatch import TorchDispatchMode
from torch.utils._pytree import tree_leaves, tree_map

# The autograd engine needs a device that it knows, and that asks for no driver.
DEVICE = torch.device("meta")
_ATEN = torch.ops.aten
_COPIES = {_ATEN._to_copy.default, _ATEN.copy_.default}
# Indices may lie on the CPU.
_INDEXING = {_ATEN.index.Tensor, _ATEN.index_put_.default, _ATEN._index_put_impl_.default}
_WAITING = {_ATEN._local_scalar_dense.default, _ATEN.nonzero.default, _ATEN.equal.default}
_PACKAGE = Path(__file__).parents[1] / "dgc_pose"


class MixedDevicesError(RuntimeError):
    """An operation was given tensors of both devices."""


class Pretended(Tensor):
    """A tensor of the pretended device."""

    held: Tensor  # on the CPU, with the numbers

    @staticmethod
    def __new__(cls, held: Tensor) -> Pretended:
        made: Pretended = Tensor._make_wrapper_subclass(  # type: ignore[attr-defined]
            cls,
            held.shape,
            strides=held.stride(),
            storage_offset=held.storage_offset(),
            dtype=held.dtype,
            device=DEVICE,
        )
        made.held = held
        return made

    def __repr__(self) -> str:  # type: ignore[override]
        return f"pretended {self.held}"

    @classmethod
    def __torch_dispatch__(
        cls, function: Any, types: Any, arguments: Any = (), options: Any = None
    ) -> Any:
        return _run(function, arguments, options or {}, Counter())


class _Generator(torch.Generator):
    """One of the CPU, whatever device is asked for."""

    def __new__(cls, device: Any = "cpu") -> _Generator:
        return super().__new__(cls)


class _Mode(TorchDispatchMode):
    def __init__(self) -> None:
        super().__init__()
        self.waits: Counter[str] = Counter()

    def __torch_dispatch__(
        self, function: Any, types: Any, arguments: Any = (), options: Any = None
    ) -> Any:
        return _run(function, arguments, options or {}, self.waits)


@contextlib.contextmanager
def pretended_gpu() -> Iterator[Counter[str]]:
    """Within, `DEVICE` holds numbers. Yields how often each line of the package waits for it."""
    tensor = torch.tensor

    def made(data: Any, *, dtype: Any = None, device: Any = None, **options: Any) -> Tensor:
        values = tensor(data, dtype=dtype, **options)
        return values if device is None else values.to(device)

    def new(self: Tensor, data: Any, *, dtype: Any = None, device: Any = None) -> Tensor:
        return tensor(data, dtype=dtype or self.dtype).to(device or self.device)

    mode = _Mode()
    # These make numbers below the level that the mode sees, or know their devices by name.
    with (
        patch.object(torch, "tensor", made),
        patch.object(Tensor, "new_tensor", new),
        patch.object(torch, "Generator", _Generator),
        patch.object(torch, "autocast", lambda *_, **__: contextlib.nullcontext()),
        mode,
    ):
        yield mode.waits


def _run(function: Any, arguments: Any, options: Any, waits: Counter[str]) -> Any:
    tensors = [leaf for leaf in tree_leaves((arguments, options)) if isinstance(leaf, Tensor)]
    pretended = [one for one in tensors if isinstance(one, Pretended)]
    if any(one.device == DEVICE and not isinstance(one, Pretended) for one in tensors):
        raise MixedDevicesError(f"{function}: a tensor without numbers")
    if pretended and function not in _COPIES | _INDEXING:
        others = [one for one in tensors if not isinstance(one, Pretended)]
        if any(one.dim() > 0 for one in others):
            raise MixedDevicesError(f"{function}: tensors of both devices")
    fetched = function in _COPIES and not isinstance(arguments[0], Pretended)
    if function is _ATEN._to_copy.default:
        fetched = torch.device(options.get("device") or DEVICE) != DEVICE
    if pretended and (function in _WAITING or fetched):
        waits[_line()] += 1
    plain_arguments, plain_options = tree_map(
        lambda leaf: leaf.held if isinstance(leaf, Pretended) else leaf, (arguments, options)
    )
    device = options.get("device")
    if device is not None:
        plain_options |= {"device": torch.device("cpu")}
    result = function(*plain_arguments, **plain_options)
    there = bool(pretended) if device is None else torch.device(device) == DEVICE

    def back(leaf: Any) -> Any:
        if not isinstance(leaf, Tensor) or not there:
            return leaf
        # What works in place hands back its argument.
        own = [one for one in pretended if one.held is leaf]
        return own[0] if own else Pretended(leaf)

    return tree_map(back, result)


def _line() -> str:
    """Where in the package we are."""
    frames = traceback.extract_stack()
    own = [frame for frame in frames if Path(frame.filename).is_relative_to(_PACKAGE)]
    return f"{Path(own[-1].filename).name}: {own[-1].name}" if own else "elsewhere"
