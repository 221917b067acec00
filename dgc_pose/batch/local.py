"""Workers on this machine: in this process, or in one process each."""

import os
import sys
from collections import deque
from collections.abc import Callable, Iterator, Sequence
from concurrent.futures import FIRST_COMPLETED, Future, wait
from contextlib import AbstractContextManager, ExitStack, contextmanager
from functools import cache, partial
from itertools import pairwise

import cv2

from dgc_pose.batch.work import Job, Outcome, Task, Worker
from dgc_pose.files.outputs import writing
from dgc_pose.system.processes import process_pools

# Worked through in any order; the same outcomes whatever the workers.
RunTasks = Callable[[Sequence[Task]], Iterator[Outcome]]
# Starts so many workers for a job; within the context tasks can be run, several times.
Workers = Callable[[Job, int], AbstractContextManager[RunTasks]]


@contextmanager
def local_workers(job: Job, workers: int) -> Iterator[RunTasks]:
    """Workers on this machine; a single one works in this process.

    Raises what `load_matcher` raises, before a process starts, and DgcPoseError if a process ends;
    `--resume` goes on after that.
    """
    if workers == 1:
        worker = Worker(job)
        yield lambda tasks: map(worker.do, tasks)
        return
    job.matcher.load()
    # One pool a worker, since neighbouring blocks share images and belong to one worker.
    with ExitStack() as stack:
        with writing("worker processes"):
            submit = stack.enter_context(process_pools([1] * workers, _start, job))

        def give(worker: int, task: Task) -> Future[Outcome]:
            with writing("worker processes"):
                return submit(worker, _do, task)

        yield lambda tasks: in_spans(tasks, workers, give)


def in_spans(
    tasks: Sequence[Task], workers: int, submit: Callable[[int, Task], Future[Outcome]]
) -> Iterator[Outcome]:
    """The outcomes of tasks as they come, each worker having one task at a time.

    Each worker gets a run of neighbouring tasks, which share images; when it is finished, the last
    tasks of the longest run that is left. submit: gives a task to the worker of that number. Raises
    what the futures raise.
    """
    bounds = [len(tasks) * i // workers for i in range(workers + 1)]
    left = [deque(tasks[first:end]) for first, end in pairwise(bounds)]
    running: dict[Future[Outcome], int] = {}

    def give(worker: int) -> None:
        if left[worker]:
            running[submit(worker, left[worker].popleft())] = worker
        elif longest := max(left, key=len):
            running[submit(worker, longest.pop())] = worker

    for worker in range(workers):
        give(worker)
    while running:
        for future in wait(running, return_when=FIRST_COMPLETED).done:
            outcome = future.result()
            give(running.pop(future))
            yield outcome


_workers: list[Callable[[], Worker]] = []  # of this process, once it has been started


def _start(job: Job) -> None:
    """The worker is loaded by the first task, so that what this raises is the error of a task."""
    _workers.append(cache(partial(core_worker, job)))


def _do(task: Task) -> Outcome:
    return _workers[0]().do(task)


def core_worker(job: Job) -> Worker:
    """A worker whose process uses one core: each other core has a worker too."""
    cv2.setNumThreads(1)
    os.environ["OMP_NUM_THREADS"] = "1"  # read when torch is imported
    worker = Worker(job)
    if "torch" in sys.modules:
        sys.modules["torch"].set_num_threads(1)
    return worker
