"""The one door through which files are read: regular files of a bounded size, whatever they hold.

Files come from anywhere. A reader of numpy, Pillow or torch raises almost anything for a damaged
one, so each kind of file is read within `read_as`, which names the file.
"""

from __future__ import annotations

import io
import json
import os
import stat
import warnings
import zipfile
from collections.abc import Iterable, Iterator, Mapping
from contextlib import contextmanager
from pathlib import Path
from typing import Any

import numpy as np

from dgc_pose.errors import DgcPoseError, InputError, reason

TEXT_BYTES = 2**26  # of a text file: a list of some 100,000 pairs
ARRAY_BYTES = 2**29  # of all arrays of a file together, as they lie in memory


def read_bytes(
    path: str | Path, limit: int = 2**31 - 1, error: type[DgcPoseError] = InputError
) -> bytes:
    """The content of a regular file, links followed.

    Raises `error`, with the path, for a pipe, a device, a folder, and for more than `limit` bytes;
    OSError, with the path, if it cannot be read.
    """
    with _opened(path, error) as descriptor:
        size = os.fstat(descriptor).st_size
        if size > limit:
            raise error(f"{path} is too large: {size} bytes, at most {limit} are read")
        data = _read(descriptor, limit + 1, path)
    if len(data) > limit:  # the kernel's files claim to be empty
        raise error(f"{path} is too large: at most {limit} bytes are read")
    return data


def read_start(path: str | Path, count: int, error: type[DgcPoseError] = InputError) -> bytes:
    """The first `count` bytes of a regular file, or all of a smaller one. Raises as
    `read_bytes` does."""
    with _opened(path, error) as descriptor:
        return _read(descriptor, count, path)


@contextmanager
def _opened(path: str | Path, error: type[DgcPoseError]) -> Iterator[int]:
    """The descriptor of a regular file."""
    try:
        # Without O_NONBLOCK the opening of a pipe waits for its writer, and the reading of some
        # regular files of the kernel waits for their content.
        descriptor = os.open(path, os.O_RDONLY | getattr(os, "O_NONBLOCK", 0))
    except ValueError:  # a zero byte in the name
        raise error(f"{str(path)!r} is no name of a file") from None
    try:
        _require_kind(os.fstat(descriptor).st_mode, path, error)
        yield descriptor
    finally:
        os.close(descriptor)


def _read(descriptor: int, count: int, path: str | Path) -> bytes:
    parts = []
    try:
        while count and (part := os.read(descriptor, min(2**24, count))):
            parts.append(part)
            count -= len(part)
    except OSError as failure:
        raise OSError(failure.errno, failure.strerror, str(path)) from None
    return b"".join(parts)


def require_regular(path: str | Path, error: type[DgcPoseError] = InputError) -> None:
    """Raise `error`, with the path, unless this is a regular file that is not empty: for libraries
    that open files themselves. OSError if it is missing."""
    try:
        status = os.stat(path)
    except ValueError:
        raise error(f"{str(path)!r} is no name of a file") from None
    _require_kind(status.st_mode, path, error)
    if not status.st_size:
        raise error(f"{path} is empty")


@contextmanager
def read_as(what: str, path: str | Path, error: type[DgcPoseError] = InputError) -> Iterator[None]:
    """Turn whatever a reader raises into `error`: "PATH is not `what` that can be read (why)".

    Our own errors and an OSError that names its file pass.
    """
    try:
        with warnings.catch_warnings():
            warnings.simplefilter("ignore")  # of readers, about what they repair
            yield
    except DgcPoseError:
        raise
    except MemoryError:
        raise error(f"{path} needs more memory than there is") from None
    except Exception as failure:
        if isinstance(failure, OSError) and failure.filename is not None:
            raise
        raise error(f"{path} is not {what} that can be read ({reason(failure)})") from failure


def read_text(path: str | Path, what: str = "a text", limit: int = TEXT_BYTES) -> str:
    """A text in UTF-8, without a byte order mark.

    Raises InputError, with the path, if it is no such text or no regular file; OSError if it cannot
    be read.
    """
    data = read_bytes(path, limit)
    try:
        return data.decode("utf-8-sig")
    except UnicodeDecodeError:
        raise InputError(f"{path}: {what} is text, and this is not") from None


def read_json(path: str | Path, what: str) -> Any:
    """The content of a JSON file. Raises as `read_text` does, and InputError for no JSON."""
    text = read_text(path, what)
    with read_as(what, path):
        return json.loads(text)


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


def _require_kind(mode: int, path: str | Path, error: type[DgcPoseError]) -> None:
    if stat.S_ISREG(mode):
        return
    kinds = {stat.S_IFDIR: "a folder", stat.S_IFIFO: "a pipe", stat.S_IFSOCK: "a socket"}
    kind = kinds.get(stat.S_IFMT(mode), "a device")
    raise error(f"{path} is {kind}, and only regular files are read")
