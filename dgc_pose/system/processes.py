"""Worker processes: a pool that ends at once."""

import multiprocessing
import os
import signal
import threading
from collections.abc import Callable, Iterator, Sequence
from concurrent.futures import Future, ProcessPoolExecutor
from concurrent.futures.process import BrokenProcessPool
from contextlib import contextmanager
from multiprocessing.process import BaseProcess
from typing import Any

import cv2

from dgc_pose.errors import ArgumentName, DgcPoseError

Submit = Callable[..., Future[Any]]  # takes a function and its arguments


@contextmanager
def process_pool(size: int, start: Callable[..., None], *arguments: Any) -> Iterator[Submit]:
    """A pool of processes, which use one core each. Any error within the context ends them at once.
    start: is called with the arguments first in each process, and must not raise.

    Raises DgcPoseError if a process ends before its work.
    """
    # Not forked: torch's threads do not survive that.
    context = multiprocessing.get_context("spawn")
    pool = ProcessPoolExecutor(size, context, _start, (start, arguments))
    others = set(multiprocessing.active_children())
    started: set[BaseProcess] = set()

    def submit(work: Callable[..., Any], *items: Any) -> Future[Any]:
        future = pool.submit(work, *items)
        started.update(set(multiprocessing.active_children()) - others)
        return future

    try:
        yield submit
    except BaseException as error:
        # Work inside a library's call handles no signal; an interrupt must not wait for it.
        for process in started:
            process.terminate()
        pool.shutdown(cancel_futures=True)  # the processes have exit codes then
        if not isinstance(error, BrokenProcessPool):
            raise
        codes = {process.exitcode or 0 for process in started}
        codes = codes - {0, -signal.SIGTERM} or codes  # the pool stops the others by SIGTERM
        ends = (signal.Signals(-n).name if n < 0 else f"exit code {n}" for n in sorted(codes))
        ended = f"a worker process ended ({', '.join(ends)}):"
        hint = "goes on from the pairs that were done"
        raise DgcPoseError(ended, ArgumentName("resume"), hint) from None
    pool.shutdown()


def _start(start: Callable[..., None], arguments: Sequence[Any]) -> None:
    # A terminal sends an interrupt to all processes: the owner of the pool answers it.
    signal.signal(signal.SIGINT, signal.SIG_IGN)
    threading.Thread(target=_end_with_parent, daemon=True).start()
    cv2.setNumThreads(1)
    start(*arguments)


def _end_with_parent() -> None:
    """If the owner of the pool is killed, nobody else ends this process."""
    parent = multiprocessing.parent_process()
    if parent is not None:
        parent.join()
        os._exit(1)
