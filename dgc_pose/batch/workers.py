"""Workers of a batch: in this process, in processes of this machine, or on a Ray cluster; and the
order of their tasks, in which each image is loaded few times."""

import logging
import os
import sys
from collections.abc import Callable, Iterator, Sequence
from concurrent.futures import as_completed
from contextlib import contextmanager
from typing import Any, TypeVar

import cv2
import numpy as np

from dgc_pose.batch.work import Job, Worker
from dgc_pose.errors import ArgumentName, DgcPoseError, reason, require
from dgc_pose.system.parallel import process_pool

Item = TypeVar("Item")
BLOCK = 32  # pairs handed to a worker at a time, and stored together
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
    with process_pool(workers, _start, job) as submit:
        yield lambda work, tasks: (
            done.result() for done in as_completed([submit(_do, work, *task) for task in tasks])
        )


@contextmanager
def ray_workers(job: Job, workers: int) -> Iterator[Run]:
    """Actors of the cluster at RAY_ADDRESS, or of one that is started on this machine.

    All machines of the cluster need the package, and the images at the same path. Raises InputError
    without Ray. Running tasks raises DgcPoseError if an actor ends; `--resume` goes on after that.
    """
    require({"engine ray": "ray"})
    import ray
    from ray.util import ActorPool

    starts = not ray.is_initialized()
    if starts:
        ray.init(
            num_cpus=None if "RAY_ADDRESS" in os.environ else workers,
            include_dashboard=False,
            log_to_driver=False,
            logging_level=logging.ERROR,
        )
    kind: Any = ray.remote(num_cpus=1, num_gpus=int(job.matcher.device == "cuda"))(CoreWorker)
    actors: list[Any] = []

    def run(work: Work, tasks: Sequence[Task]) -> Iterator[Any]:
        try:
            pool: Any = ActorPool(actors)
            yield from pool.map_unordered(lambda actor, task: actor.do.remote(work, *task), tasks)
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


class CoreWorker:
    """A worker whose process uses one core: each other core has a worker too.

    The first task loads the matcher, so that what this raises is the error of a task.
    """

    def __init__(self, job: Job) -> None:
        self._job = job
        self._worker: Worker | None = None

    def do(self, work: Work, *task: Any) -> Any:
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


def tile_order(pairs: np.ndarray, capacity: int) -> np.ndarray:
    """Indices (P,) of the pairs (P, 2) of images in the order to work in: by tiles, of which the
    images fit into memory together.

    capacity: images whose features fit into the memory of one worker.
    """
    low, high = np.sort(pairs, axis=1).T
    side = max(1, capacity // 2)
    tile1, tile2 = low // side, high // side
    # Back and forth along the rows of tiles: a row begins with the tile that the last ended at.
    column = np.where(tile1 % 2 == 0, tile2, -tile2)
    return np.lexsort((low, high, column, tile1))


def block_size(pairs: int, workers: int) -> int:
    """Pairs of a block: fewer in a small batch, so that all workers have something to do."""
    return min(BLOCK, max(1, pairs // (4 * workers)))


def blocks_of(items: Sequence[Item], size: int) -> list[Sequence[Item]]:
    """Runs of at most `size` successive items."""
    return [items[i : i + size] for i in range(0, len(items), size)]
