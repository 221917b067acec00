"""Parallel work, in threads, which an interrupt does not wait for, and in processes."""

import multiprocessing
import os
import signal
import threading
from collections.abc import Callable, Iterator, Sequence
from concurrent.futures import Future, ProcessPoolExecutor
from concurrent.futures.process import BrokenProcessPool
from contextlib import contextmanager
from functools import cache
from multiprocessing.process import BaseProcess
from typing import Any, TypeVar

import cv2
from threadpoolctl import ThreadpoolController

from dgc_pose.errors import ArgumentName, DgcPoseError

Item = TypeVar("Item")
Result = TypeVar("Result")
Submit = Callable[..., Future[Any]]  # takes a function and its arguments


@contextmanager
def one_blas_thread() -> Iterator[None]:
    """Limit NumPy's matrix products to one thread within the block. They are small, or already in
    parallel in `in_threads`: further threads would wait for each other.

    Only in the main thread: two threads could undo each other's settings.
    """
    if threading.current_thread() is threading.main_thread():
        with _blas().limit(limits=1):
            yield
    else:
        yield


@cache
def _blas() -> ThreadpoolController:
    """The BLAS libraries loaded at the first call, as NumPy's is. The search for them takes
    more than a millisecond."""
    return ThreadpoolController().select(user_api="blas")


def usable_cpus() -> int:
    """Processors that this process may run on."""
    return len(os.sched_getaffinity(0))


def slices(count: int, size: int) -> list[slice]:
    """Slices of `size` that cover `count` rows, for `in_threads`; at least one."""
    return [slice(i, i + size) for i in range(0, max(1, count), size)]


class _Helper(threading.Thread):
    """One of several threads of `in_threads`."""


def in_threads(work: Callable[[Item], Result], items: Sequence[Item]) -> list[Result]:
    """`[work(item) for item in items]`, in as many threads as OpenCV uses.

    For work that spends its time outside of Python and depends only on its item, so that the result
    is the same for any number of threads. `cv2.setNumThreads` sets the number, here and in OpenCV;
    the default is the number of processors. A call within such work runs item by item: processors
    are busy, and large pieces run faster in parallel than small ones. A ThreadPoolExecutor does not
    serve: at its end a process would wait for the executor's threads.

    Raises the error of the first item that fails. An exception of an interrupt or a signal handler
    in the main thread is raised at once: what has begun is discarded, the rest is not begun.
    """
    count = min(cv2.getNumThreads(), len(items))
    current = threading.current_thread()
    if isinstance(current, _Helper) or (count <= 1 and current is not threading.main_thread()):
        return [work(item) for item in items]  # only the main thread handles signals
    results: dict[int, Result] = {}
    errors: dict[int, BaseException] = {}
    waiting = iter(range(len(items)))
    stopped = threading.Event()

    def run() -> None:
        for number in waiting:  # shared by the threads
            if stopped.is_set():
                return
            try:
                results[number] = work(items[number])
            except BaseException as error:
                errors[number] = error
                return

    # Daemons: the process can end while a library call, which nothing can stop, still runs.
    kind = _Helper if count > 1 else threading.Thread
    threads = [kind(target=run, daemon=True) for _ in range(max(count, 1))]
    try:
        for thread in threads:
            thread.start()
        for thread in threads:
            thread.join()  # the interpreter runs signal handlers while it waits
    finally:
        stopped.set()
    if errors:
        raise errors[min(errors)]
    return [results[number] for number in range(len(items))]


@contextmanager
def process_pool(size: int, start: Callable[..., None], *arguments: Any) -> Iterator[Submit]:
    """A pool of processes that use one core each. Any error within the context ends them at once.
    start: called first in each process, with the arguments; must not raise.

    Raises DgcPoseError if a process ends before its work is done.
    """
    # Not forked: torch's threads do not survive a fork.
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
        pool.shutdown(cancel_futures=True)  # afterwards the processes have exit codes
        if not isinstance(error, BrokenProcessPool):
            raise
        codes = {process.exitcode or 0 for process in started}
        codes = codes - {0, -signal.SIGTERM} or codes  # the pool stops the others by SIGTERM
        ends = (signal.Signals(-n).name if n < 0 else f"exit code {n}" for n in sorted(codes))
        ended = f"a worker process ended ({', '.join(ends)}):"
        hint = "continues after the finished pairs"
        raise DgcPoseError(ended, ArgumentName("resume"), hint) from None
    pool.shutdown()


def _start(start: Callable[..., None], arguments: Sequence[Any]) -> None:
    # A terminal sends an interrupt to all processes: only the owner of the pool handles it.
    signal.signal(signal.SIGINT, signal.SIG_IGN)
    threading.Thread(target=_end_with_parent, daemon=True).start()
    cv2.setNumThreads(1)
    start(*arguments)


def _end_with_parent() -> None:
    """End this process with the owner of the pool: if that is killed, nothing else ends it."""
    parent = multiprocessing.parent_process()
    if parent is not None:
        parent.join()
        os._exit(1)
