"""Reading files: regular ones alone, of a bounded size.

For a damaged file a reader of NumPy, Pillow or torch raises almost anything, so a file is parsed
within `read_as`, which names it.
"""

import os
import warnings
from collections.abc import Iterator
from contextlib import contextmanager, suppress
from pathlib import Path
from typing import BinaryIO

from dgc_pose.errors import DgcPoseError, InputError, reason
from dgc_pose.files.outputs import writing

TEXT_BYTES = 2**26  # of a text file: a list of some 100,000 pairs
_START_BYTES = 4096  # of a text, which have no zero byte


def open_file(path: str | Path, error: type[DgcPoseError] = InputError) -> BinaryIO:
    """A regular file to read, links followed.

    Raises `error`, with the path, for a folder, a pipe, which would wait for its writer, a device
    and no name of a file; OSError, with the path, if it cannot be opened.
    """
    with suppress(ValueError):  # a zero byte
        if os.path.isfile(path) or not os.path.exists(path):
            return open(path, "rb")
    raise error(Path(path), "is no regular file")


def read_bytes(
    path: str | Path, limit: int = 2**31 - 1, error: type[DgcPoseError] = InputError
) -> bytes:
    """The content of a file. Raises as `open_file` does, and `error` for more than `limit` bytes;
    OSError, with the path, if it cannot be read."""
    with open_file(path, error) as stream, writing(path):
        size = os.fstat(stream.fileno()).st_size
        if size > limit:
            raise error(Path(path), f"is too large: {size} bytes, at most {limit} are read")
        return stream.read(size)


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
    data = read_bytes(path, limit)
    with suppress(UnicodeDecodeError):
        if b"\0" not in data[:_START_BYTES]:
            return data.decode("utf-8-sig")
    raise InputError(Path(path), f"is not text, and {what} is")
