"""Workers as actors of a Ray cluster: the same tasks and outcomes as `local_workers`.

An actor loads the matcher once. It gets neighbouring blocks, which share images, one at a time; the
outcomes come back to this process, which stores them. If an actor dies, another one is started and
does its block again. The package must be installed on all machines of the cluster, and the images
must lie at the same path.
"""

from __future__ import annotations

import logging
import os
from collections import Counter
from collections.abc import Iterator, Sequence
from contextlib import contextmanager
from typing import Any

from dgc_pose.batch.local import CoreWorker, RunTasks
from dgc_pose.batch.schedule import Spans
from dgc_pose.batch.work import Job, Outcome, Task
from dgc_pose.errors import DgcPoseError, InputError, reason

MOST_TRIES = 3  # of one block, whose worker may end each time


@contextmanager
def ray_workers(job: Job, workers: int) -> Iterator[RunTasks]:
    """Actors of the cluster at RAY_ADDRESS, or of one that is started on this machine.

    Raises InputError without Ray. `run` raises DgcPoseError if a block kills its worker again and
    again; `--resume` goes on after that.
    """
    try:
        import ray
    except ModuleNotFoundError:
        raise InputError("--engine ray needs Ray: pip install 'dgc-pose[ray]'") from None
    starts = not ray.is_initialized()
    if starts:
        cores = None if "RAY_ADDRESS" in os.environ else workers
        ray.init(
            num_cpus=cores,
            include_dashboard=False,
            log_to_driver=False,
            logging_level=logging.ERROR,
        )
    try:
        actors = _Actors(ray, job, workers)
        yield actors.run
        actors.stop()
    finally:
        if starts:
            ray.shutdown()


def actor_name(number: int) -> str:
    """The name of an actor, in Ray's namespace of this process."""
    return f"dgc-pose-{os.getpid()}-{number}"


class _Actors:
    """The actors of a job, each with one block at a time."""

    def __init__(self, ray: Any, job: Job, workers: int) -> None:
        self._ray = ray
        self._job = ray.put(job)
        needs = {"num_gpus": 1} if job.matcher.device == "cuda" else {}
        self._kind = ray.remote(num_cpus=1, **needs)(CoreWorker)
        self._started = 0
        self._actors = [self._start() for _ in range(workers)]

    def run(self, tasks: Sequence[Task]) -> Iterator[Outcome]:
        """The outcomes of tasks, as they come."""
        spans = Spans(len(tasks), len(self._actors))
        running: dict[Any, tuple[int, int]] = {}  # the actor and the task of each call
        failures: Counter[int] = Counter()

        def submit(number: int) -> None:
            index = spans.take(number)
            if index is not None:
                call = self._actors[number].do.remote(tasks[index])
                running[call] = (number, index)

        for number in range(len(self._actors)):
            submit(number)
        while running:
            (call, *_), _ = self._ray.wait(list(running), num_returns=1)
            number, index = running.pop(call)
            try:
                outcome = self._ray.get(call)
            except self._ray.exceptions.RayActorError as error:
                failures[index] += 1
                if failures[index] == MOST_TRIES:
                    raise DgcPoseError(
                        f"{MOST_TRIES} workers ended on the same block of pairs "
                        f"({reason(error)}): --resume goes on from the pairs that were done"
                    ) from None
                self._actors[number] = self._start()
                spans.put_back(number, index)
                submit(number)
                continue
            except self._ray.exceptions.RayTaskError as error:
                raise error.as_instanceof_cause() from None
            submit(number)
            yield outcome

    def stop(self) -> None:
        """End the actors; a cluster that others use stays."""
        for actor in self._actors:
            self._ray.kill(actor)

    def _start(self) -> Any:
        name = actor_name(self._started)
        self._started += 1
        return self._kind.options(name=name).remote(self._job)
