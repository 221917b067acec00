"""Workers as actors of a Ray cluster: the same tasks and outcomes as `local_workers`.

This process stores the outcomes. Ray starts an actor that dies again, and has it redo its block.
All machines of the cluster need the package, and the images at the same path.
"""

import logging
import os
from collections.abc import Iterator, Sequence
from concurrent.futures import Future
from contextlib import contextmanager
from typing import Any

from dgc_pose.batch.local import RunTasks, core_worker, in_spans
from dgc_pose.batch.work import Job, Outcome, Task, Worker
from dgc_pose.errors import ArgumentName, DgcPoseError, reason, require

MOST_TRIES = 3  # of one block, whose worker may end each time


@contextmanager
def ray_workers(job: Job, workers: int) -> Iterator[RunTasks]:
    """Actors of the cluster at RAY_ADDRESS; without that, a cluster is started on this machine.

    Raises InputError without Ray. Running tasks raises DgcPoseError if a block kills its worker
    again and again; `--resume` goes on after that.
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
    kind: Any = ray.remote(
        num_cpus=1,
        num_gpus=1 if job.matcher.device == "cuda" else 0,
        max_restarts=-1,
        max_task_retries=MOST_TRIES - 1,
    )(_Actor)

    def submit(worker: int, task: Task) -> Future[Outcome]:
        future: Future[Outcome] = actors[worker].do.remote(job_reference, task).future()
        return future

    def run(tasks: Sequence[Task]) -> Iterator[Outcome]:
        try:
            yield from in_spans(tasks, workers, submit)
        except ray.exceptions.RayActorError as error:
            raise DgcPoseError(
                f"{MOST_TRIES} workers ended on the same block of pairs ({reason(error)}):",
                ArgumentName("resume"),
                "goes on from the pairs that were done",
            ) from None
        except ray.exceptions.RayTaskError as error:
            raise error.cause from None

    try:
        job_reference = [ray.put(job)]
        actors = [
            kind.options(name=f"dgc-pose-{os.getpid()}-{number}").remote()
            for number in range(workers)
        ]
        yield run
        for actor in actors:
            ray.kill(actor)  # a cluster that others use stays
    finally:
        if starts:
            ray.shutdown()


class _Actor:
    """Takes the job from Ray's store with the first task, also when it was started again."""

    _worker: Worker | None = None

    def do(self, job_reference: Sequence[Any], task: Task) -> Outcome:
        if self._worker is None:
            import ray

            self._worker = core_worker(ray.get(job_reference[0]))
        return self._worker.do(task)
