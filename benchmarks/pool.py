"""The processes that estimate poses. What is imported here must not import torch: each would."""

from __future__ import annotations

import multiprocessing
import signal
import threading
from collections.abc import Callable, Iterator
from concurrent.futures import Future, ProcessPoolExecutor
from concurrent.futures.process import BrokenProcessPool
from contextlib import contextmanager

import cv2

from dgc_pose.benchmarks.scores import Score
from dgc_pose.benchmarks.scoring import Job, Scored, score
from dgc_pose.errors import DgcPoseError
from dgc_pose.system.processes import end_with_parent, process_ends


@contextmanager
def pose_pool(
    kind: type[Score], workers: int
) -> Iterator[Callable[[Job[Score]], Future[Scored[Score]]]]:
    """A function that has a job done: in this process at once, or by one of `workers` others.

    kind: of the records. Raises DgcPoseError if a process ends before its work.
    """
    if workers == 1:
        yield _done_here
        return
    # Not forked: torch's threads do not survive that.
    context = multiprocessing.get_context("spawn")
    pool = ProcessPoolExecutor(workers, mp_context=context, initializer=_start_worker)
    others = set(multiprocessing.active_children())
    started: set[multiprocessing.process.BaseProcess] = set()

    def submit(job: Job[Score]) -> Future[Scored[Score]]:
        future = pool.submit(score, job)
        started.update(set(multiprocessing.active_children()) - others)
        return future

    try:
        yield submit
    except BrokenProcessPool:
        pool.shutdown()  # the processes have exit codes then
        raise DgcPoseError(
            f"a process that estimates poses ended: {process_ends(started)}; "
            "--resume goes on from the last pair that was done"
        ) from None
    except BaseException:
        # A job inside a library's call handles no signal; an interrupt must not wait for it.
        for process in started:
            process.terminate()
        raise
    finally:
        pool.shutdown(cancel_futures=True)


def _done_here(job: Job[Score]) -> Future[Scored[Score]]:
    future: Future[Scored[Score]] = Future()
    future.set_result(score(job))
    return future


def _start_worker() -> None:
    # A terminal sends an interrupt to all processes: the owner of the pool answers it.
    signal.signal(signal.SIGINT, signal.SIG_IGN)
    cv2.setNumThreads(1)
    threading.Thread(target=end_with_parent, daemon=True).start()
