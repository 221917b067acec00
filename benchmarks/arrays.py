"""Arrays of NumPy's archives .npz."""

import io
import zipfile
from collections.abc import Mapping
from pathlib import Path

import numpy as np

from dgc_pose.errors import InputError
from dgc_pose.files.arrays import ARRAY_BYTES
from dgc_pose.files.inputs import read_as, read_bytes


def read_arrays(path: str | Path) -> Mapping[str, np.ndarray]:
    """The arrays of an .npz by name.

    Raises InputError, with the path, if it is damaged, holds Python objects, or is larger than
    `ARRAY_BYTES` unpacked; OSError if it cannot be read.
    """
    data = read_bytes(path, ARRAY_BYTES + 2**20)
    with read_as("an .npz", path), zipfile.ZipFile(io.BytesIO(data)) as archive:
        members = {
            name: info
            for info in archive.infolist()
            if (name := info.filename.removesuffix(".npy")) != info.filename
        }
        if sum(info.file_size for info in members.values()) > ARRAY_BYTES:
            raise InputError(f"{path} is too large: at most {ARRAY_BYTES} bytes of arrays are read")
        arrays = {}
        for name, info in members.items():
            with archive.open(info) as stream:
                arrays[name] = np.lib.format.read_array(stream, allow_pickle=False)
        return arrays
