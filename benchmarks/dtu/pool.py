"""The processes that estimate poses. Nothing here or in what it imports needs torch: each of them
would load it."""

from __future__ import annotations

import multiprocessing
import os
import threading
from collections.abc import Callable, Iterator, Sequence
from concurrent.futures import Future, ProcessPoolExecutor
from concurrent.futures.process import BrokenProcessPool
from contextlib import contextmanager

import cv2

from dgc_pose.benchmarks.dtu.scoring import Job, Scored, score
from dgc_pose.errors import DgcPoseError

Submit = Callable[[Job], "Future[Scored]"]


@contextmanager
def pose_pool(workers: int) -> Iterator[Submit]:
    """A function that has a job done: at once and here, or by one of so many processes."""
    if workers == 1:
        yield _done_here
        return
    # Not forked: torch's threads do not survive that.
    context = multiprocessing.get_context("spawn")
    pool = ProcessPoolExecutor(workers, mp_context=context, initializer=_start_worker)
    try:
        yield lambda job: pool.submit(score, job)
    finally:
        pool.shutdown(cancel_futures=True)


def _done_here(job: Job) -> Future[Scored]:
    future: Future[Scored] = Future()
    future.set_result(score(job))
    return future


def are_done(futures: Sequence[Future[Scored]]) -> bool:
    """Whether none of them has to be waited for."""
    return all(future.done() for future in futures)


def result(future: Future[Scored]) -> Scored:
    """Wait for a job. Raises what the job raised, DgcPoseError where its process was killed."""
    try:
        return future.result()
    except BrokenProcessPool:
        raise DgcPoseError(
            "a process that estimates poses was killed (for want of memory?); "
            "--resume goes on from the last pair that was done"
        ) from None


def _start_worker() -> None:
    cv2.setNumThreads(1)
    threading.Thread(target=_end_with_parent, daemon=True).start()


def _end_with_parent() -> None:
    """A pool whose owner is killed would wait for work for ever."""
    parent = multiprocessing.parent_process()
    if parent is not None:
        parent.join()
        os._exit(1)
