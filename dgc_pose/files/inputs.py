"""Reading files: regular ones alone, of a bounded size.

For a damaged file a reader of NumPy, Pillow or torch raises almost anything, so a file is parsed
within `read_as`, which names it.
"""

import os
import stat
import warnings
from collections.abc import Iterator
from contextlib import contextmanager, suppress
from pathlib import Path
from typing import BinaryIO

from dgc_pose.errors import DgcPoseError, InputError, reason
from dgc_pose.files.outputs import writing

TEXT_BYTES = 2**26  # of a text file: a list of some 100,000 pairs
_START_BYTES = 4096  # that tell a text from another file, which may be far larger than a text
_KINDS = {stat.S_IFDIR: "a folder", stat.S_IFIFO: "a pipe", stat.S_IFSOCK: "a socket"}


def read_bytes(
    path: str | Path, limit: int = 2**31 - 1, error: type[DgcPoseError] = InputError
) -> bytes:
    """The content of a regular file, links followed.

    Raises `error`, with the path, for a pipe, a device, a folder, and for more than `limit` bytes;
    OSError, with the path, if it cannot be read.
    """
    with open_regular(path, error) as stream, writing(path):
        size = os.fstat(stream.fileno()).st_size
        if size > limit:
            raise error(Path(path), f"is too large: {size} bytes, at most {limit} are read")
        return stream.read(size)


def read_start(path: str | Path, count: int, error: type[DgcPoseError] = InputError) -> bytes:
    """The first `count` bytes of a regular file, or all of a smaller one. Raises as
    `read_bytes` does."""
    with open_regular(path, error) as stream, writing(path):
        return stream.read(count)


def open_regular(path: str | Path, error: type[DgcPoseError] = InputError) -> BinaryIO:
    """A regular file to read piece by piece. Raises as `read_bytes` does."""
    try:
        mode = os.stat(path).st_mode  # before it is opened: a pipe would wait for its writer
    except ValueError:  # a zero byte
        raise error(f"{str(path)!r} is no name of a file") from None
    if not stat.S_ISREG(mode):
        kind = _KINDS.get(stat.S_IFMT(mode), "a device")
        raise error(Path(path), f"is {kind}, and only regular files are read")
    return open(path, "rb")


def require_regular(path: str | Path, error: type[DgcPoseError] = InputError) -> None:
    """Raise `error`, with the path, unless this is a regular file that is not empty: for libraries
    that open files themselves. OSError, with the path, if it cannot be read."""
    if not read_start(path, 1, error):
        raise error(Path(path), "is empty")


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
        raise error(Path(path), "needs more memory than there is") from None
    except Exception as failure:
        if isinstance(failure, OSError) and failure.filename is not None:
            raise
        why = f"is not {what} that can be read ({reason(failure)})"
        raise error(Path(path), why) from failure


def read_text(path: str | Path, what: str = "a text", limit: int = TEXT_BYTES) -> str:
    """A text in UTF-8, without a byte order mark.

    Raises InputError, with the path, if it is no such text, has a zero byte near its beginning, as
    almost any other file has, or is no regular file; OSError if it cannot be read.
    """
    with suppress(UnicodeDecodeError):
        if b"\0" not in read_start(path, _START_BYTES):
            return read_bytes(path, limit).decode("utf-8-sig")
    raise InputError(Path(path), f"is not text, and {what} is")
