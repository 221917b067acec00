"""The loop of every pose benchmark: match the pairs of a data set, estimate, compare.

Pairs are matched in this process, batch by batch; poses are estimated here or in a pool.
"""

from __future__ import annotations

import hashlib
import json
import time
from collections import deque
from collections.abc import Iterator, Sequence
from concurrent.futures import Future
from dataclasses import asdict, dataclass
from itertools import islice
from typing import Any, Generic

from dgc_pose.benchmarks.methods import Engine, Engines, Method
from dgc_pose.benchmarks.pool import pose_pool
from dgc_pose.benchmarks.posed_pairs import PairSet, PosedPair
from dgc_pose.benchmarks.scores import Score
from dgc_pose.benchmarks.scoring import Job, Scored, map_errors
from dgc_pose.matching import MatchResult
from dgc_pose.system.options import check_options, option


@dataclass(frozen=True)
class RunOptions:
    """How a data set is worked through. Raises InputError, naming the field, below 1."""

    workers: int = option(1, min=1)  # processes that estimate poses; one is this process
    batch: int = option(1, min=1)  # pairs that a network matches together

    def __post_init__(self) -> None:
        check_options(self)


@dataclass(frozen=True)
class Evaluation(Generic[Score]):
    """Methods on a data set."""

    pairs: PairSet[Score]
    methods: Sequence[Method]
    engines: Engines
    options: RunOptions = RunOptions()

    def run(self, first: int = 0) -> Iterator[list[Scored[Score]]]:
        """For each pair from number `first` on, in order, a record a method.

        The same whatever `first` and `workers`: batches begin at the same pairs, and the seed of a
        pair is its own.

        Raises what reading a pair raises, and DgcPoseError if a process of the pool ended.
        """
        batch, workers = self.options.batch, self.options.workers
        number = first - first % batch
        pairs = self.pairs.read(number)
        waiting: deque[list[Future[Scored[Score]]]] = deque()
        with pose_pool(self.pairs.kind, workers) as submit:
            while some := list(islice(pairs, batch)):
                for jobs in self.match(some):
                    if number >= first:
                        waiting.append([submit(job) for job in jobs])
                    number += 1
                while waiting and (len(waiting) > 2 * workers or _all_done(waiting[0])):
                    yield [future.result() for future in waiting.popleft()]
            while waiting:
                yield [future.result() for future in waiting.popleft()]

    def match(self, batch: Sequence[PosedPair]) -> list[list[Job[Score]]]:
        """Match pairs together: for each a job a method."""
        found: dict[int, list[_Matched]] = {}
        for method in self.methods:
            engine = self.engines.of(method)
            if id(engine) not in found:
                found[id(engine)] = _match(engine, batch)
        return [
            [
                self._job(method, pair, found[id(self.engines.of(method))][number])
                for method in self.methods
            ]
            for number, pair in enumerate(batch)
        ]

    def settings(self, device: str) -> dict[str, Any]:
        """All that the records depend on, for `RunStore`; the number of workers does not count."""
        ids = json.dumps([dict(one) for one in self.pairs.ids])
        return {
            "pairs": hashlib.sha256(ids.encode()).hexdigest()[:16],
            "methods": [asdict(method) for method in self.methods],
            "weights": self.engines.fingerprints,
            "batch": self.options.batch,
            "device": device,
        }

    def _job(self, method: Method, pair: PosedPair, matched: _Matched) -> Job[Score]:
        start = time.perf_counter()
        engine = self.engines.of(method)
        matches = engine.matches(method, pair.image1, pair.image2, matched.found)
        selected = time.perf_counter() - start
        return Job(
            kind=self.pairs.kind,
            method=method.name,
            truth=pair.truth,
            matches=matches,
            map_matches=None if method.everywhere else matched.found.map_matches,
            everywhere_px=matched.everywhere_px,
            options=method.options.estimation,
            match_seconds=matched.seconds + selected,
        )


@dataclass(frozen=True)
class _Matched:
    found: MatchResult
    everywhere_px: tuple[float, float]  # median and mean D_e over all pixels, NaN without a map
    seconds: float  # of this pair; the mean over its batch


def _match(engine: Engine, batch: Sequence[PosedPair]) -> list[_Matched]:
    start = time.perf_counter()
    results = engine.matcher.match_batch([(one.image1, one.image2) for one in batch])
    seconds = (time.perf_counter() - start) / len(batch)
    return [
        _Matched(found, map_errors(pair.truth, found.correspondence_map), seconds)
        for found, pair in zip(results, batch, strict=True)
    ]


def _all_done(futures: Sequence[Future[Scored[Score]]]) -> bool:
    return all(future.done() for future in futures)
