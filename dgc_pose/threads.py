"""Parallel work in threads."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from concurrent.futures import ThreadPoolExecutor
from typing import TypeVar

import cv2

Item = TypeVar("Item")
Result = TypeVar("Result")


def in_threads(work: Callable[[Item], Result], items: Sequence[Item]) -> list[Result]:
    """`[work(item) for item in items]`, in as many threads as OpenCV uses.

    For work that spends its time outside of Python and depends on its item alone, so that the
    answer is the same for any number of threads. `cv2.setNumThreads` sets the number for both; the
    default is the number of processors.
    """
    threads = min(cv2.getNumThreads(), len(items))
    if threads <= 1:
        return [work(item) for item in items]
    with ThreadPoolExecutor(threads) as pool:
        return list(pool.map(work, items))
