"""Independent pieces of work side by side, in threads."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from concurrent.futures import ThreadPoolExecutor
from typing import TypeVar

import cv2

Item = TypeVar("Item")
Result = TypeVar("Result")


def in_threads(work: Callable[[Item], Result], items: Sequence[Item]) -> list[Result]:
    """`[work(item) for item in items]`, in as many threads as OpenCV is set to take.

    For work that spends its time outside of Python and hangs on nothing but its item, so that the
    answer is the same for any number of threads. One number serves OpenCV and this:
    `cv2.setNumThreads`, the processors' own count by default.
    """
    threads = min(cv2.getNumThreads(), len(items))
    if threads <= 1:
        return [work(item) for item in items]
    with ThreadPoolExecutor(threads) as pool:
        return list(pool.map(work, items))
