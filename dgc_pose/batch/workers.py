"""The workers of a batch match pairs and estimate poses: in this process, in processes of this
machine, or on a Ray cluster. Their tasks are ordered so that each image is loaded few times.
"""

import logging
import os
import sys
from collections.abc import Callable, Collection, Iterator, Mapping, Sequence
from concurrent.futures import as_completed
from contextlib import contextmanager
from dataclasses import dataclass, replace
from itertools import islice
from pathlib import Path
from typing import Any, TypeVar

import cv2
import numpy as np

from dgc_pose.batch.given.matches import GivenMatches
from dgc_pose.batch.pairs import BAD_INPUT, FAILED, MatchedPair, PairRow, row_of
from dgc_pose.batch.store import BatchStore
from dgc_pose.cameras.camera import Camera
from dgc_pose.errors import ArgumentName, DgcPoseError, ImageError, InputError, reason, require
from dgc_pose.estimation import EstimationOptions, estimate_pose, reject_contradicted_K
from dgc_pose.estimation.intrinsics_prior import may_be_crop
from dgc_pose.estimation.options import Second
from dgc_pose.images.cache import ImageCache
from dgc_pose.images.image import Image, require_matchable
from dgc_pose.matchers import MatcherOptions
from dgc_pose.matching.surroundings import surroundings
from dgc_pose.pose import solve_pair
from dgc_pose.system.parallel import process_pool

# Approximate bytes of an image's features, without its pixels: encoder (7 MiB), refinement (12 MiB
# for each matched part of the image), and copies for the search of views (4 MiB).
FEATURE_BYTES = 24 * 2**20
# Standard deviation of ln f up to which a camera is known: better than the fit of a single pair.
KNOWN_FOCAL_STD = 0.05
BLOCK = 32  # pairs handed to a worker at a time, and stored together
_BLOCKS_HELD = 4  # blocks of matches in memory, for each worker
Item = TypeVar("Item")
Cameras = Mapping[str, Camera]  # by image name
# A method of `Worker`, and the arguments of one call.
Work = Callable[..., Any]
Task = tuple[Any, ...]
# Runs tasks; may be called repeatedly. Outcomes come in any order and do not depend on the workers.
Run = Callable[[Work, Sequence[Task]], Iterator[Any]]


@dataclass(frozen=True)
class Job:
    """The settings that all pairs of a batch share. Each worker receives them once."""

    root: Path  # folder that the image names are relative to
    cameras: Cameras  # each with the size of its image
    bad: Mapping[str, str]  # by name, why an image is known to be unusable
    matcher: MatcherOptions
    estimation: EstimationOptions
    memory_bytes: int  # limit of the images and features that a worker keeps
    masks: Path | None = None  # folder of the images' masks
    given: GivenMatches | None = None  # matches to judge, instead of matching the images


class Worker:
    """Loads the matcher once and runs tasks. Keeps images and features in memory up to the job's
    limit, and drops the least recently used. An unusable image makes its pairs bad, but does not
    stop the batch.

    Raises what `load_matcher` raises.
    """

    def __init__(self, job: Job) -> None:
        self.job = job
        self.bad = dict(job.bad)
        self.cache = ImageCache(job.memory_bytes, beside_bytes=FEATURE_BYTES)
        self.matcher = job.matcher.load(self.cache)

    def describe(self, names: Sequence[str]) -> dict[str, np.ndarray | str]:
        """By image name, the coarsest features (cells, C) float16, or why the image is bad."""
        described: dict[str, np.ndarray | str] = {}
        for name in names:
            if (image := self._image(name)) is None:
                described[name] = self.bad[name]
            else:
                described[name] = self.matcher.coarse_features(image).astype(np.float16)
        return described

    def match(
        self, pairs: Sequence[tuple[int, tuple[str, str]]], second: Second = "none"
    ) -> list[MatchedPair]:
        """Match pairs, given by index and names, and estimate the pose of each on its own."""
        rows = [
            PairRow(*names, FAILED, "", index=index, second=second == "auto")
            for index, names in pairs
        ]
        return [_done(row, self._matched, row.names, self.job.cameras, second) for row in rows]

    def estimate(
        self, pairs: Sequence[MatchedPair], cameras: Cameras, fit_cameras: bool
    ) -> list[MatchedPair]:
        """Estimate the poses of matched pairs again, with new cameras.

        fit_cameras: whether each pair also refits cameras that are known already.
        """
        return [_done(pair.row, self._estimated, pair, cameras, fit_cameras) for pair in pairs]

    def _matched(
        self, names: tuple[str, str], cameras: Cameras, second: Second = "none"
    ) -> MatchedPair:
        if self.job.given is not None:
            return self._judged(names, cameras, self.job.given)
        image1, image2 = (self._image(name) for name in names)
        if image1 is None or image2 is None:
            return self._bad(names)
        pair = cameras[names[0]], cameras[names[1]]
        options = replace(self.job.estimation, second=second)
        solved = solve_pair(image1, image2, pair, self.matcher, options)
        dense = solved.correspondence_map
        exact = pair[0].exact and pair[1].exact
        row = row_of(names, reject_contradicted_K(solved.pose, pair), solved.matches.error_px)
        return MatchedPair(row, solved.matches, None if dense is None or exact else dense.sample)

    def _judged(self, names: tuple[str, str], cameras: Cameras, given: GivenMatches) -> MatchedPair:
        """The pose by the given matches; with photographs, also by what surrounds the matches."""
        if any(name in self.bad for name in names):
            return self._bad(names)
        if names[0] == names[1]:
            raise InputError(f"matches of {names[0]} with itself")
        matches = given.read(names)
        if given.with_images:
            image1, image2 = (self.cache.read(self.job.root, name) for name in names)
            upright = given.on_upright(matches, image1, image2)
            around = surroundings(self.matcher, image1, image2, upright)
            matches = replace(matches, context_ratio=around)
        pair = cameras[names[0]], cameras[names[1]]
        pose = estimate_pose(matches, *pair, self.job.estimation)
        return MatchedPair(
            row_of(names, reject_contradicted_K(pose, pair), matches.error_px), matches
        )

    def _bad(self, names: tuple[str, str]) -> MatchedPair:
        bad = {name: self.bad[name] for name in names if name in self.bad}
        return MatchedPair(PairRow(*names, BAD_INPUT, "; ".join(bad.values()), bad_images=bad))

    def _estimated(self, pair: MatchedPair, cameras: Cameras, fit_cameras: bool) -> MatchedPair:
        row = pair.row
        names = pair.row.names
        if row.pose is None or all(self.job.cameras[name].exact for name in names):
            return pair
        both = camera1, camera2 = cameras[names[0]], cameras[names[1]]
        may_be_mirrored = row.status == "ambiguous" and row.pose.evidence is None
        if row.status == "mirrored" or may_be_mirrored:  # wrong cameras may be the cause
            exact = camera1.exact and camera2.exact
            second: Second = "auto" if row.second else "none"
            return pair if exact else self._matched(names, cameras, second)
        # Errors of two cameras are independent, and so are those of images without an identity.
        known = camera1.identity is not None and camera1.identity == camera2.identity
        known &= all(c.focal_std <= KNOWN_FOCAL_STD and not may_be_crop(c) for c in both)
        given = self.job.given
        weights = self.matcher.fingerprint if given is None else given.read(names).weights
        matches = replace(pair.matches, weights=weights)
        pose = estimate_pose(
            *(matches, *both, self.job.estimation),
            map_matches=pair.map_matches,
            fit_cameras=fit_cameras or not known,
        )
        return MatchedPair(row_of(names, pose, matches.error_px), matches, pair.map_matches)

    def _image(self, name: str) -> Image | None:
        """The image; None if it is unusable, with the reason in `bad`."""
        if name in self.bad:
            return None
        try:
            image = self.cache.read(self.job.root, name, self.job.masks)
            size = self.job.cameras[name].size
            if size is not None and tuple(size) != image.size:
                differ = "its header states another size than its pixels have"
                raise ImageError(f"{image.name}: {differ}")
            require_matchable(image)
            return image
        except DgcPoseError as error:
            self.bad[name] = str(error)
            return None


def _done(row: PairRow, work: Callable[..., MatchedPair], *arguments: Any) -> MatchedPair:
    """The outcome of work on the pair of a row; after an error, a row with it as its reason."""
    try:
        pair = work(*arguments)
    except MemoryError:  # every further pair would raise it too
        raise
    except DgcPoseError as error:
        pair = MatchedPair(PairRow(*row.names, BAD_INPUT, str(error)))
    except Exception as error:  # one pair of a million must not end the batch
        pair = MatchedPair(PairRow(*row.names, FAILED, f"{type(error).__name__}: {error}"))
    return replace(pair, row=replace(pair.row, index=row.index, second=row.second))


@contextmanager
def local_workers(job: Job, workers: int) -> Iterator[Run]:
    """Workers on this machine; a single worker runs in this process.

    Raises what `load_matcher` raises, before any process starts, and DgcPoseError if a process
    dies; the batch can then be resumed.
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
    """Actors on the cluster at RAY_ADDRESS, or on a new cluster on this machine.

    All machines of the cluster need the package, and the images at the same path. Raises InputError
    without Ray. Running tasks raises DgcPoseError if an actor dies; the batch can then be resumed.
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
                f"a Ray worker ended ({reason(error)}):",
                ArgumentName("resume"),
                "continues after the finished pairs",
            ) from None
        except ray.exceptions.RayTaskError as error:
            raise error.cause from None

    try:
        shared = ray.put(job)
        actors += [kind.remote(shared) for _ in range(workers)]
        yield run
    finally:
        for actor in actors:
            ray.kill(actor)  # the cluster may be shared, and keeps running
        if starts:
            ray.shutdown()


class CoreWorker:
    """A worker whose process uses one core, because every core has a worker.

    The first task loads the matcher, so that a loading error is an error of a task.
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


_process_worker: list[CoreWorker] = []  # the worker of this process, once it has been started


def _start(job: Job) -> None:
    _process_worker.append(CoreWorker(job))


def _do(work: Work, *task: Any) -> Any:
    return _process_worker[0].do(work, *task)


@dataclass(frozen=True)
class PoseRunner:
    """Estimates the poses of stored pairs with workers."""

    store: BatchStore  # holds the matched pairs
    run: Run
    workers: int

    def estimate(
        self, cameras: Cameras, *, fit: bool, only: Collection[int] | None = None
    ) -> Iterator[MatchedPair]:
        """Yield the pairs with their poses by these cameras, in any order. fit: whether every pair
        refits its cameras, or only pairs without known cameras. only: indices of some pairs."""
        indices = self.store.indices("matched") if only is None else only
        size = block_size(len(indices), self.workers)
        pairs = self.store.pairs("matched", indices)
        while held := list(islice(pairs, size * _BLOCKS_HELD * self.workers)):
            tasks = []
            for block in blocks_of(held, size):
                names = {name for pair in block for name in pair.row.names}
                tasks.append((block, {n: cameras[n] for n in names if n in cameras}, fit))
            for outcome in self.run(Worker.estimate, tasks):
                yield from outcome


def tile_order(pairs: np.ndarray, capacity: int) -> np.ndarray:
    """Indices (P,) of image pairs (P, 2) in working order: tile by tile, where the images of one
    tile fit into memory together.

    capacity: number of images whose features fit into the memory of one worker.
    """
    low, high = np.sort(pairs, axis=1).T
    side = max(1, capacity // 2)
    tile1 = low // side
    tile2 = high // side
    # Back and forth along the rows of tiles: a row begins at the column where the last one ended.
    column = np.where(tile1 % 2 == 0, tile2, -tile2)
    return np.lexsort((low, high, column, tile1))


def block_size(pairs: int, workers: int) -> int:
    """Number of pairs in a block: fewer in a small batch, so that every worker gets some."""
    return min(BLOCK, max(1, pairs // (4 * workers)))


def blocks_of(items: Sequence[Item], size: int) -> list[Sequence[Item]]:
    """The items in blocks of at most `size`."""
    return [items[i : i + size] for i in range(0, len(items), size)]
