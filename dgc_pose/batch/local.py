"""Workers on this machine: in this process, or in one process each."""

from __future__ import annotations

import multiprocessing
import os
import signal
import sys
import threading
from collections.abc import Callable, Iterator, Sequence
from concurrent.futures import FIRST_COMPLETED, Future, ProcessPoolExecutor, wait
from concurrent.futures.process import BrokenProcessPool
from contextlib import AbstractContextManager, ExitStack, contextmanager
from functools import cached_property
from multiprocessing.process import BaseProcess
from typing import Protocol

import cv2

from dgc_pose.batch.schedule import Spans
from dgc_pose.batch.work import Job, Outcome, Task, Worker
from dgc_pose.errors import DgcPoseError
from dgc_pose.system.processes import end_with_parent, process_ends

# Worked through in any order; the same outcomes whatever the workers.
RunTasks = Callable[[Sequence[Task]], Iterator[Outcome]]


class Workers(Protocol):
    """Starts workers for a job; within the context tasks can be run, several times."""

    def __call__(self, job: Job, workers: int) -> AbstractContextManager[RunTasks]: ...


@contextmanager
def local_workers(job: Job, workers: int) -> Iterator[RunTasks]:
    """Workers on this machine; a single one works in this process.

    Raises what `load_matcher` raises, before a process starts. `run` raises DgcPoseError if a
    process ends; `--resume` goes on after that.
    """
    if workers == 1:
        own = Worker(job)
        yield lambda tasks: (own.do(task) for task in tasks)
        return
    job.matcher.load()
    # Not forked: torch's threads do not survive that. One pool a worker, since neighbouring blocks
    # share images and belong to one worker.
    context = multiprocessing.get_context("spawn")
    others = set(multiprocessing.active_children())
    with ExitStack() as stack:
        pools = []
        for _ in range(workers):
            pool = ProcessPoolExecutor(1, context, _start, (job,))
            stack.callback(pool.shutdown, cancel_futures=True)
            pools.append(pool)
        try:
            yield lambda tasks: _run(pools, tasks, others)
        except BaseException:
            # A block takes long, and within a library's call no signal is handled.
            for process in set(multiprocessing.active_children()) - others:
                process.terminate()
            raise


def _run(
    pools: Sequence[ProcessPoolExecutor], tasks: Sequence[Task], others: set[BaseProcess]
) -> Iterator[Outcome]:
    """others: children of this process that are not of the pools."""
    spans = Spans(len(tasks), len(pools))
    running: dict[Future[Outcome], int] = {}

    def submit(number: int) -> None:
        index = spans.take(number)
        if index is not None:
            running[pools[number].submit(_do, tasks[index])] = number

    for number in range(len(pools)):
        submit(number)
    processes = set(multiprocessing.active_children()) - others
    while running:
        done, _ = wait(running, return_when=FIRST_COMPLETED)
        for future in done:
            number = running.pop(future)
            try:
                outcome = future.result()
            except BrokenProcessPool:
                pools[number].shutdown()  # its process has an exit code then
                raise DgcPoseError(
                    f"a worker process ended ({process_ends(processes)}): --resume goes on from "
                    "the pairs that were done"
                ) from None
            submit(number)
            yield outcome


_worker: list[CoreWorker] = []  # of this process, once it has been started


def _start(job: Job) -> None:
    # A terminal sends an interrupt to all processes: the owner of the pools answers it.
    signal.signal(signal.SIGINT, signal.SIG_IGN)
    threading.Thread(target=end_with_parent, daemon=True).start()
    _worker[:] = [CoreWorker(job)]


def _do(task: Task) -> Outcome:
    return _worker[0].do(task)


class CoreWorker:
    """A worker whose process uses one core: the other cores have workers of their own.

    The first task loads the matcher, so that what this raises is the error of a task.
    """

    def __init__(self, job: Job) -> None:
        self._job = job

    def do(self, task: Task) -> Outcome:
        return self._worker.do(task)

    @cached_property
    def _worker(self) -> Worker:
        cv2.setNumThreads(1)
        os.environ["OMP_NUM_THREADS"] = "1"  # read when torch is imported
        worker = Worker(self._job)
        if "torch" in sys.modules:
            sys.modules["torch"].set_num_threads(1)
        return worker
