"""The benchmark's loop: pairs are matched here, and their poses estimated here or in a pool."""

from __future__ import annotations

import time
from collections import deque
from collections.abc import Iterator, Sequence
from concurrent.futures import Future
from dataclasses import dataclass

import numpy as np

from dgc_pose.benchmarks.dtu.entries import Entry
from dgc_pose.benchmarks.dtu.epipolar import median_and_mean, true_fundamental
from dgc_pose.benchmarks.dtu.methods import Engines, Method, matches_of
from dgc_pose.benchmarks.dtu.pool import are_done, pose_pool, result
from dgc_pose.benchmarks.dtu.protocols import (
    PairReader,
    ShownPair,
    estimation_options,
    matching_options,
)
from dgc_pose.benchmarks.dtu.records import Protocol
from dgc_pose.benchmarks.dtu.scoring import Job, Scored
from dgc_pose.errors import InputError
from dgc_pose.estimation import EstimationOptions
from dgc_pose.matching import Matcher, MatchingOptions, MatchResult


@dataclass(frozen=True)
class RunOptions:
    """How a list is worked through. Raises InputError on values out of range."""

    protocol: Protocol
    matching: MatchingOptions
    estimation: EstimationOptions
    workers: int = 1  # processes that estimate poses; one is this process
    batch: int = 1  # pairs that a network matches together

    def __post_init__(self) -> None:
        for name in ("workers", "batch"):
            if getattr(self, name) < 1:
                raise InputError(f"{name} must be at least 1, not {getattr(self, name)}")


def run(
    entries: Sequence[Entry],
    methods: Sequence[Method],
    engines: Engines,
    options: RunOptions,
    first: int = 0,
) -> Iterator[list[Scored]]:
    """Yield for each pair from number `first` on, in the order of the list, a row for each method.

    The same whatever `first` and `workers`: batches begin at the same pairs, and each pair has a
    seed of its own.

    Raises ImageError for an image that cannot be read, InputError where a K cannot belong to it,
    DgcPoseError where a process of the pool was killed.
    """
    reader = PairReader(options.protocol)
    waiting: deque[list[Future[Scored]]] = deque()
    with pose_pool(options.workers) as submit:
        for start in range(first - first % options.batch, len(entries), options.batch):
            batch = entries[start : start + options.batch]
            all_jobs = match_batch(batch, methods, engines, reader, options)
            for number, jobs in enumerate(all_jobs, start):
                if number >= first:
                    waiting.append([submit(job) for job in jobs])
            while waiting and (len(waiting) > 2 * options.workers or are_done(waiting[0])):
                yield [result(future) for future in waiting.popleft()]
        while waiting:
            yield [result(future) for future in waiting.popleft()]


def match_batch(
    batch: Sequence[Entry],
    methods: Sequence[Method],
    engines: Engines,
    reader: PairReader,
    options: RunOptions,
) -> list[list[Job]]:
    """Match a batch: for each pair a job for each method. One matching pass serves all methods of
    an engine."""
    shown = [reader.read(one.scene, one.view1, one.view2, one.pair) for one in batch]
    found: dict[str, list[_Matched]] = {}
    for name in dict.fromkeys(method.engine for method in methods):
        found[name] = _match(engines.by_name[name], shown)
    selection = matching_options(options.protocol, options.matching)
    estimation = estimation_options(options.protocol, options.estimation)
    jobs: list[list[Job]] = [[] for _ in batch]
    for method in methods:
        for own, entry, one, matched in zip(
            jobs, batch, shown, found[method.engine], strict=True
        ):
            start = time.perf_counter()
            matches = matches_of(method, matched.found, selection)
            selected = time.perf_counter() - start
            own.append(
                Job(
                    method=method.name,
                    entry=entry,
                    protocol=options.protocol,
                    truth=one.truth,
                    matches=matches,
                    everywhere_px=matched.everywhere_px,
                    options=estimation,
                    match_seconds=matched.seconds + selected,
                )
            )
    return jobs


@dataclass(frozen=True)
class _Matched:
    found: MatchResult
    everywhere_px: tuple[float, float]  # median and mean D_e over all pixels, NaN without a map
    seconds: float  # of this pair; the mean over its batch


def _match(engine: Matcher, shown: Sequence[ShownPair]) -> list[_Matched]:
    start = time.perf_counter()
    founds = engine.match_batch([(one.image1, one.image2) for one in shown])
    seconds = (time.perf_counter() - start) / len(shown)
    return [
        _Matched(found, _everywhere(found, one), seconds)
        for found, one in zip(founds, shown, strict=True)
    ]


def _everywhere(result: MatchResult, shown: ShownPair) -> tuple[float, float]:
    found = result.correspondence_map
    if found is None:
        return np.nan, np.nan
    return median_and_mean(found.map, found.grid, true_fundamental(shown.truth))
