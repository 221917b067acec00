"""Workers of a batch: in this process, in processes of this machine, or on a Ray cluster."""

import logging
import os
import sys
from collections import deque
from collections.abc import Callable, Iterator, Sequence
from concurrent.futures import FIRST_COMPLETED, Future, wait
from contextlib import ExitStack, contextmanager
from itertools import pairwise
from typing import Any

import cv2

from dgc_pose.batch.work import Job, Worker
from dgc_pose.errors import ArgumentName, DgcPoseError, reason, require
from dgc_pose.files.outputs import writing
from dgc_pose.system.processes import process_pools

# A method of `Worker`, and its arguments: what is done.
Work = Callable[..., Any]
Task = tuple[Any, ...]
# Does tasks, several times; the outcomes come in any order and are the same whatever the workers.
Run = Callable[[Work, Sequence[Task]], Iterator[Any]]


@contextmanager
def local_workers(job: Job, workers: int) -> Iterator[Run]:
    """Workers on this machine; a single one works in this process.

    Raises what `load_matcher` raises, before a process starts, and DgcPoseError if a process ends;
    `--resume` goes on after that.
    """
    if workers == 1:
        worker = Worker(job)
        yield lambda work, tasks: (work(worker, *task) for task in tasks)
        return
    job.matcher.load()
    # One pool a worker, since neighbouring blocks share images and belong to one worker.
    with ExitStack() as stack:
        with writing("worker processes"):
            submit = stack.enter_context(process_pools([1] * workers, _start, job))

        def run(work: Work, tasks: Sequence[Task]) -> Iterator[Any]:
            def give(worker: int, task: Task) -> Future[Any]:
                with writing("worker processes"):
                    return submit(worker, _do, work, *task)

            return in_spans(tasks, workers, give)

        yield run


@contextmanager
def ray_workers(job: Job, workers: int) -> Iterator[Run]:
    """Actors of the cluster at RAY_ADDRESS; without that, a cluster is started on this machine.

    All machines of the cluster need the package, and the images at the same path. Raises InputError
    without Ray. Running tasks raises DgcPoseError if an actor ends; `--resume` goes on after that.
    """
    require({"engine ray": "ray"})
    import ray

    starts = not ray.is_initialized()
    if starts:
        ray.init(
            num_cpus=None if "RAY_ADDRESS" in os.environ else workers,
            include_dashboard=False,
            log_to_driver=False,
            logging_level=logging.ERROR,
        )
    gpus = 1 if job.matcher.device == "cuda" else 0
    kind: Any = ray.remote(num_cpus=1, num_gpus=gpus)(CoreWorker)
    actors: list[Any] = []

    def run(work: Work, tasks: Sequence[Task]) -> Iterator[Any]:
        try:
            yield from in_spans(
                tasks, workers, lambda worker, task: actors[worker].do.remote(work, *task).future()
            )
        except ray.exceptions.RayActorError as error:
            raise DgcPoseError(
                f"a worker of Ray ended ({reason(error)}):",
                ArgumentName("resume"),
                "goes on from the pairs that were done",
            ) from None
        except ray.exceptions.RayTaskError as error:
            raise error.cause from None

    try:
        shared = ray.put(job)
        actors += [kind.remote(shared) for _ in range(workers)]
        yield run
    finally:
        for actor in actors:
            ray.kill(actor)  # a cluster that others use stays
        if starts:
            ray.shutdown()


def in_spans(
    tasks: Sequence[Any], workers: int, submit: Callable[[int, Any], Future[Any]]
) -> Iterator[Any]:
    """The outcomes of tasks as they come, each worker having one task at a time.

    Each worker gets a run of neighbouring tasks, which share images; when it is finished, the last
    tasks of the longest run that is left. submit: gives a task to the worker of that number. Raises
    what the futures raise.
    """
    bounds = [len(tasks) * i // workers for i in range(workers + 1)]
    left = [deque(tasks[first:end]) for first, end in pairwise(bounds)]
    running: dict[Future[Any], int] = {}

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


class CoreWorker:
    """A worker whose process uses one core: each other core has a worker too.

    The first task loads the matcher, so that what this raises is the error of a task.
    """

    def __init__(self, job: Job) -> None:
        self._job = job
        self._worker: Worker | None = None

    def do(self, work: Work, *task: Any) -> Any:
        """The outcome of a task."""
        if self._worker is None:
            cv2.setNumThreads(1)
            os.environ["OMP_NUM_THREADS"] = "1"  # read when torch is imported
            self._worker = Worker(self._job)
            if "torch" in sys.modules:
                sys.modules["torch"].set_num_threads(1)
        return work(self._worker, *task)


_of_process: list[CoreWorker] = []  # the worker of this process, once it has been started


def _start(job: Job) -> None:
    _of_process.append(CoreWorker(job))


def _do(work: Work, *task: Any) -> Any:
    return _of_process[0].do(work, *task)
