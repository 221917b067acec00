"""Work in parallel threads, for whose results an interrupt does not wait."""

import os
import threading
from collections.abc import Callable, Sequence
from concurrent.futures import ThreadPoolExecutor
from typing import TypeVar

import cv2

Item = TypeVar("Item")
Result = TypeVar("Result")


def usable_cpus() -> int:
    """Processors that this process may run on."""
    if hasattr(os, "sched_getaffinity"):  # neither on macOS nor on Windows
        return len(os.sched_getaffinity(0))
    return os.cpu_count() or 1


def slices(count: int, size: int) -> list[slice]:
    """Slices of `size` that cover `count` rows, for `in_threads`; at least one."""
    return [slice(i, i + size) for i in range(0, max(1, count), size)]


def in_threads(work: Callable[[Item], Result], items: Sequence[Item]) -> list[Result]:
    """`[work(item) for item in items]`, in as many threads as OpenCV uses.

    For work that spends its time outside of Python and depends on its item alone, so that the
    answer is the same for any number of threads. `cv2.setNumThreads` sets the number for both; the
    default is the number of processors.

    Raises the error of the first item that has one. What a signal's handler raises in the main
    thread is raised at once, and work that has not begun is not begun.
    """
    count = min(cv2.getNumThreads(), len(items))
    if count <= 1 and threading.current_thread() is not threading.main_thread():
        return [work(item) for item in items]  # signals are handled in the main thread alone
    pool = ThreadPoolExecutor(max(count, 1))
    try:
        return list(pool.map(work, items))
    finally:
        pool.shutdown(wait=False, cancel_futures=True)
