"""Worker processes: pools that end at once."""

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

Submit = Callable[..., Future[Any]]  # takes the number of a pool, a function and its arguments


@contextmanager
def process_pools(
    sizes: Sequence[int], start: Callable[..., None] | None = None, *arguments: Any
) -> Iterator[Submit]:
    """Pools of so many processes each, which use one core each. Any error within the context ends
    the processes at once. start: is called with the arguments first in each process, and must not
    raise.

    Raises DgcPoseError if a process ends before its work.
    """
    # Not forked: torch's threads do not survive that.
    context = multiprocessing.get_context("spawn")
    pools = [ProcessPoolExecutor(size, context, _start, (start, arguments)) for size in sizes]
    others = set(multiprocessing.active_children())
    started: set[BaseProcess] = set()

    def submit(pool: int, work: Callable[..., Any], *items: Any) -> Future[Any]:
        future = pools[pool].submit(work, *items)
        started.update(set(multiprocessing.active_children()) - others)
        return future

    try:
        yield submit
    except BaseException as error:
        # Work inside a library's call handles no signal; an interrupt must not wait for it.
        for process in started:
            process.terminate()
        for pool in pools:
            pool.shutdown(cancel_futures=True)  # the processes have exit codes then
        if not isinstance(error, BrokenProcessPool):
            raise
        codes = {process.exitcode or 0 for process in started}
        codes = codes - {0, -signal.SIGTERM} or codes  # the pool stops the others by SIGTERM
        ends = (signal.Signals(-n).name if n < 0 else f"exit code {n}" for n in sorted(codes))
        ended = f"a worker process ended ({', '.join(ends)}):"
        hint = "goes on from the pairs that were done"
        raise DgcPoseError(ended, ArgumentName("resume"), hint) from None
    for pool in pools:
        pool.shutdown()


def _start(start: Callable[..., None] | None, arguments: Sequence[Any]) -> None:
    # A terminal sends an interrupt to all processes: the owner of the pools answers it.
    signal.signal(signal.SIGINT, signal.SIG_IGN)
    threading.Thread(target=_end_with_parent, daemon=True).start()
    cv2.setNumThreads(1)
    if start is not None:
        start(*arguments)


def _end_with_parent() -> None:
    """Wait for the owner of the pools, and end with it: if that is killed, nobody else ends this
    process."""
    parent = multiprocessing.parent_process()
    if parent is not None:
        parent.join()
        os._exit(1)
