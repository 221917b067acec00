"""Arrays: those of an argument, and those of NumPy's files .npy and .npz."""

from __future__ import annotations

import io
import zipfile
from collections.abc import Iterable, Mapping
from pathlib import Path
from typing import Any

import numpy as np

from dgc_pose.errors import InputError
from dgc_pose.files.inputs import read_as, read_bytes

ARRAY_BYTES = 2**29  # of all arrays of a file together, as they lie in memory


def is_tensor(value: Any) -> bool:
    """Whether `value` has the methods of a torch tensor."""
    return all(hasattr(value, method) for method in ("detach", "cpu", "numpy"))


def as_numpy(value: Any, name: str) -> np.ndarray:
    """`value` as a NumPy array of booleans, integers or floats; shares memory if possible.

    Raises InputError, naming the argument `name`, if `value` is no array of real numbers.
    """
    try:
        if is_tensor(value):
            value = value.detach().cpu()
            # NumPy has no bfloat16.
            value = (value.float() if "bfloat16" in str(value.dtype) else value).numpy()
        array = np.asarray(value)
    except (TypeError, ValueError, RuntimeError) as error:
        raise InputError(f"{name} is not an array of numbers") from error
    if array.dtype.kind not in "buif":
        raise InputError(f"{name} is not an array of real numbers but {type(value).__name__}")
    return array


def read_array(path: str | Path) -> np.ndarray:
    """The array of an .npy. Raises InputError, with the path, if it is damaged, holds Python
    objects, or is larger than `ARRAY_BYTES`; OSError if it cannot be read."""
    data = read_bytes(path, ARRAY_BYTES + 2**16)
    with read_as("an .npy", path):
        return _array(data)


def read_arrays(path: str | Path, names: Iterable[str] | None = None) -> Mapping[str, np.ndarray]:
    """The arrays of an .npz by name; with `names`, those of them that it has.

    Raises InputError, with the path, if it is damaged, holds Python objects, or is larger than
    `ARRAY_BYTES` unpacked; OSError if it cannot be read.
    """
    data = read_bytes(path, ARRAY_BYTES + 2**20)
    with read_as("an .npz", path), zipfile.ZipFile(io.BytesIO(data)) as archive:
        members = {
            info.filename.removesuffix(".npy"): info
            for info in archive.infolist()
            if info.filename.endswith(".npy")
        }
        chosen = [name for name in (members if names is None else names) if name in members]
        if sum(members[name].file_size for name in chosen) > ARRAY_BYTES:
            raise InputError(f"{path} is too large: at most {ARRAY_BYTES} bytes of arrays are read")
        return {name: _array(_unpacked(archive, members[name])) for name in chosen}


def _unpacked(archive: zipfile.ZipFile, info: zipfile.ZipInfo) -> bytes:
    with archive.open(info) as stream:
        return stream.read(info.file_size)  # no more than it claims


def _array(data: bytes) -> np.ndarray:
    """An array from the bytes of an .npy, whose size is checked before memory is taken for it."""
    stream = io.BytesIO(data)
    version = np.lib.format.read_magic(stream)
    reader = {
        (1, 0): np.lib.format.read_array_header_1_0,
        (2, 0): np.lib.format.read_array_header_2_0,
    }.get(version)
    if reader is None:
        raise ValueError(f"version {version} of the format")
    shape, by_columns, kind = reader(stream)
    if kind.hasobject:
        raise ValueError("it holds Python objects")
    count = 1
    for side in shape:
        count *= side
    if min(shape, default=0) < 0 or count * kind.itemsize != len(data) - stream.tell():
        raise ValueError(f"{len(data) - stream.tell()} bytes are not those of {shape} {kind}")
    flat = np.frombuffer(data, kind, count, stream.tell())
    return flat.reshape(shape, order="F" if by_columns else "C").copy()
