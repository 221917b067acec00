"""Parallel work in threads, which an interrupt does not wait for."""

import os
import threading
from collections.abc import Callable, Iterator, Sequence
from contextlib import contextmanager
from typing import TypeVar

import cv2
from threadpoolctl import threadpool_limits

Item = TypeVar("Item")
Result = TypeVar("Result")


@contextmanager
def one_blas_thread() -> Iterator[None]:
    """NumPy's products in one thread, and then in as many as before. They are small, or side by
    side in `in_threads`: further threads would wait for each other.

    In the main thread alone: of two threads each could set back what the other has set.
    """
    if threading.current_thread() is threading.main_thread():
        with threadpool_limits(limits=1, user_api="blas"):
            yield
    else:
        yield


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

    For work that spends its time outside of Python and depends on its item alone, so that the
    answer is the same for any number of threads. `cv2.setNumThreads` sets the number for both; the
    default is the number of processors. Within such work a call goes item by item: the processors
    have work already, and large pieces are done faster side by side than small ones. At its end a
    process would wait for the threads of a ThreadPoolExecutor.

    Raises the error of the first item that has one. If an interrupt or a signal's handler raises in
    the main thread, it is raised at once: what has begun is discarded, the rest is not begun.
    """
    count, current = min(cv2.getNumThreads(), len(items)), threading.current_thread()
    if isinstance(current, _Helper) or (count <= 1 and current is not threading.main_thread()):
        return [work(item) for item in items]  # signals are handled in the main thread alone
    results: dict[int, Result] = {}
    errors: dict[int, BaseException] = {}
    waiting, stopped = iter(range(len(items))), threading.Event()

    def run() -> None:
        for number in waiting:  # shared by the threads
            if stopped.is_set():
                return
            try:
                results[number] = work(items[number])
            except BaseException as error:
                errors[number] = error
                return

    # Daemons: the process may end while a library's call, which nothing can stop, goes on.
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
