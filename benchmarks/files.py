"""Archives of arrays that are read, and tables and data that are written."""

import io
import math
import zipfile
from collections.abc import Iterable, Mapping
from pathlib import Path
from typing import Any

import numpy as np

from dgc_pose.errors import InputError
from dgc_pose.files.arrays import ARRAY_BYTES
from dgc_pose.files.inputs import read_as, read_bytes
from dgc_pose.files.json_files import finite_or_none
from dgc_pose.files.tables import aligned


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


def table(columns: Mapping[str, str], rows: Iterable[object]) -> str:
    """A line for each row below the headings; a column's text, such as "{0.seconds:.2f}", is
    formatted with the row."""
    cells = ([text.format(row) for text in columns.values()] for row in rows)
    return aligned([[*columns], *cells])


def decimals(value: float, digits: int) -> str:
    """The value with so many decimals; "-" for NaN and infinity."""
    return f"{value:.{digits}f}" if math.isfinite(value) else "-"


def finite_data(data: Any) -> Any:
    """Data for `json_text`: None in place of every NaN and infinity, however deep."""
    if isinstance(data, Mapping):
        return {key: finite_data(value) for key, value in data.items()}
    if isinstance(data, list | tuple):
        return [finite_data(value) for value in data]
    return finite_or_none(data) if isinstance(data, float) else data


def split_names(text: str) -> list[str]:
    """The names in a comma-separated list, without blanks around them; empty ones are dropped."""
    return [name for name in (part.strip() for part in text.split(",")) if name]
