"""Worker processes: how they end, told by what the system says of them."""

from __future__ import annotations

import multiprocessing
import os
import signal
from collections.abc import Iterable
from multiprocessing.process import BaseProcess


def process_end(code: int | None) -> str:
    """How a process ended, in words, from the exit code that `multiprocessing` gives."""
    if code is None or code >= 0:
        return f"exit code {code}"
    return f"signal {-code}, {signal.strsignal(-code)}"


def process_ends(processes: Iterable[BaseProcess]) -> str:
    """How those of the processes that have ended did, in words.

    A pool whose process has ended stops the others by SIGTERM, which says nothing of the cause.
    """
    codes = {process.exitcode for process in processes} - {None}
    return "; ".join(sorted(map(process_end, codes - {-signal.SIGTERM} or codes)))


def end_with_parent() -> None:
    """Wait for the owner of a pool, and end with it: if that is killed, nobody else ends this
    process. For a thread."""
    parent = multiprocessing.parent_process()
    if parent is not None:
        parent.join()
        os._exit(1)
