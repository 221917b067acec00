"""Arrays, from arguments and from NumPy's .npy and .npz files."""

import io
from collections.abc import Mapping
from pathlib import Path
from typing import Any

import numpy as np

from dgc_pose.errors import InputError
from dgc_pose.system.files import read_as, read_bytes

ARRAY_BYTES = 2**29  # most bytes of all arrays of a file together, in memory


def is_tensor(value: Any) -> bool:
    """Whether `value` has the methods of a torch tensor."""
    return all(hasattr(value, method) for method in ("detach", "cpu", "numpy"))


def as_numpy(value: Any, name: str) -> np.ndarray:
    """`value` as a NumPy array of booleans, integers or floats; shares memory if possible.

    Raises InputError, naming the argument `name`, if `value` is not an array of real numbers.
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
        kind = f"{type(value).__name__} of dtype {array.dtype}"
        raise InputError(f"{name} is not an array of real numbers but {kind}")
    return array


def read_array(path: str | Path) -> np.ndarray:
    """The array of an .npy file. Raises InputError, with the path, if the file is damaged, contains
    Python objects, or is larger than `ARRAY_BYTES`; OSError if it cannot be read."""
    data = read_bytes(path, ARRAY_BYTES + 2**16)
    with read_as("an .npy", path):
        return np.lib.format.read_array(io.BytesIO(data), allow_pickle=False)


def read_arrays(path: str | Path) -> Mapping[str, np.ndarray]:
    """The arrays of an .npz file by name.

    Raises InputError, with the path, if the file is damaged, contains Python objects, or is larger
    than `ARRAY_BYTES` unpacked; OSError if it cannot be read.
    """
    return unpacked(read_bytes(path, ARRAY_BYTES + 2**20), path)


def unpacked(data: bytes, path: str | Path) -> Mapping[str, np.ndarray]:
    """The arrays in the bytes of an .npz file. Raises InputError as `read_arrays` does."""
    with read_as("an .npz", path), np.load(io.BytesIO(data)) as file:
        if sum(info.file_size for info in file.zip.infolist()) > ARRAY_BYTES:
            most = f"the limit is {ARRAY_BYTES} bytes of arrays"
            raise InputError(Path(path), f"is too large: {most}")
        return {name: file[name] for name in file.files}
