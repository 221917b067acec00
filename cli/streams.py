"""The standard streams of the command: none is closed, and errors of stdout name it."""

from __future__ import annotations

import os
import sys
from collections.abc import Iterator
from contextlib import contextmanager, redirect_stdout
from io import TextIOWrapper
from typing import Any, TextIO

from dgc_pose.errors import InputError
from dgc_pose.files.outputs import writing


class _Stdout:
    """A stream whose OSErrors name `stdout`."""

    def __init__(self, stream: TextIO) -> None:
        self._stream = stream

    def __getattr__(self, name: str) -> Any:
        return getattr(self._stream, name)

    def write(self, text: str) -> int:
        with writing("stdout"):
            return self._stream.write(text)

    def flush(self) -> None:
        with writing("stdout"):
            self._stream.flush()


@contextmanager
def standard_streams() -> Iterator[None]:
    """Within the block stdin and stderr lead somewhere, and an OSError of stdout names it.

    Raises InputError if stdout is closed.
    """
    for number in range(3):
        try:
            os.fstat(number)
        except OSError:  # the next file would get this number, and with it what libraries print
            os.set_inheritable(os.open(os.devnull, os.O_RDWR), True)
    if sys.stderr is None:
        sys.stderr = open(os.devnull, "w", encoding="utf-8")
    if sys.stdout is None:
        raise InputError("stdout is closed")
    if isinstance(sys.stdout, TextIOWrapper):
        sys.stdout.reconfigure(errors="surrogateescape")  # as names of files are decoded
    with redirect_stdout(_Stdout(sys.stdout)):
        yield
