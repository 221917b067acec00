"""The loop of every pose benchmark: match the pairs of a data set, estimate, compare.

Pairs are matched in this process; poses are estimated here or in other processes.
"""

from __future__ import annotations

import hashlib
import json
import time
from collections import deque
from collections.abc import Iterator, Sequence
from concurrent.futures import Future
from dataclasses import asdict, dataclass, replace
from typing import Any, Generic

import numpy as np

from dgc_pose.benchmarks.methods import Matchers, Method
from dgc_pose.benchmarks.posed_pairs import PairSet, PosedPair
from dgc_pose.benchmarks.scores import MapScore, Score
from dgc_pose.benchmarks.scoring import MatchedPair, epipolar_errors, pair_seed, score
from dgc_pose.cameras.camera import Camera
from dgc_pose.errors import InputError
from dgc_pose.estimation import EstimationOptions
from dgc_pose.matchers import MatcherOptions
from dgc_pose.matching import CorrespondenceMap, MatchResult, PairSearch, select_matches
from dgc_pose.pose import pose_of_pair
from dgc_pose.system.processes import process_pools


@dataclass(frozen=True)
class Evaluation(Generic[Score]):
    """Methods on a data set."""

    pairs: PairSet[Score]
    methods: Sequence[Method]
    matchers: Matchers
    workers: int = 1  # processes that estimate poses; one is this process

    def run(self, first: int = 0) -> Iterator[list[Score]]:
        """For each pair from number `first` on, in order, a record a method.

        The same whatever `first` and `workers`: the seed of a pair depends on nothing else.

        Raises what reading a pair raises, and DgcPoseError if a process ends before its work.
        """
        matched = (self._match(pair) for pair in self.pairs.read(first))
        if self.workers == 1:
            yield from ([score(pair) for pair in methods] for methods in matched)
            return
        waiting: deque[list[Future[Score]]] = deque()
        with process_pools([self.workers]) as submit:
            for methods in matched:
                waiting.append([submit(0, score, pair) for pair in methods])
                while waiting and (
                    len(waiting) > 2 * self.workers or all(future.done() for future in waiting[0])
                ):
                    yield [future.result() for future in waiting.popleft()]
            while waiting:
                yield [future.result() for future in waiting.popleft()]

    def settings(self, device: str) -> dict[str, Any]:
        """All that the records depend on, for `RunStore`; the number of workers does not count."""
        ids = json.dumps([dict(pair_ids) for pair_ids in self.pairs.ids])
        return {
            "pairs": hashlib.sha256(ids.encode()).hexdigest()[:16],
            "methods": [asdict(method) for method in self.methods],
            "weights": {
                options.weights: matcher.fingerprint
                for options, matcher in self.matchers.items()
                if matcher.fingerprint is not None
            },
            "device": device,
        }

    def _match(self, pair: PosedPair) -> Iterator[MatchedPair[Score]]:
        """The matches of a pair by every method."""
        searches: dict[MatcherOptions, _Search] = {}
        for method in self.methods:
            if method.matcher not in searches:
                matcher = self.matchers[method.matcher]
                searches[method.matcher] = _Search(matcher.search(pair.image1, pair.image2), {})
            search, everywhere_px = searches[method.matcher], (np.nan, np.nan)
            if issubclass(self.pairs.kind, MapScore) and (dense := search.whole_map):
                everywhere_px = epipolar_errors(pair.truth, dense.map, dense.grid)
            cameras, options = method.cameras.cameras(pair), method.estimation
            if pair.truth.seed:
                options = replace(options, seed=pair_seed(options.seed, *pair.truth.seed))
            final, seconds = search.matches(method, cameras, options)
            yield MatchedPair(
                kind=self.pairs.kind,
                method=method.name,
                truth=pair.truth,
                cameras=cameras,
                matches=final.matches,
                map_matches=None if method.everywhere else final.map_matches,
                everywhere_px=everywhere_px,
                options=options,
                match_seconds=seconds,
            )


@dataclass(frozen=True)
class _Search:
    """The search of a pair by all methods of the same matching."""

    search: PairSearch
    seconds: dict[str, float]  # of each step, when it was done for the first time

    @property
    def whole_map(self) -> CorrespondenceMap | None:
        """The dense map that the step `whole` begins with; None for key points."""
        return self.search.unrefined.correspondence_map

    def matches(
        self, method: Method, cameras: tuple[Camera, Camera], options: EstimationOptions
    ) -> tuple[MatchResult, float]:
        """The matches that the pose of a method is of, and the seconds of the steps to them."""
        start = time.perf_counter()
        if method.everywhere:
            if (dense := self.whole_map) is None:
                raise InputError(f"{method.name}: {self.search.matcher.name} makes no map")
            everywhere = replace(method.matcher.matching, matchability=0.0, cycle_px=None)
            every = select_matches(dense, everywhere, min_share=0.0)
            result, steps = MatchResult(every, dense), {"everywhere": time.perf_counter() - start}
        elif method.matcher.refinement.source == "none":
            result = self.search.whole()
            steps = {"match": time.perf_counter() - start}
        else:
            pose = pose_of_pair(self.search, *cameras, options)
            result = self.search.last
            steps = {step: s for step, s in pose.seconds.items() if step != "estimate"}
        for step, seconds in steps.items():
            self.seconds[step] = max(seconds, self.seconds.get(step, 0.0))
        return result, sum(self.seconds[step] for step in steps)
