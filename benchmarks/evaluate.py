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
from dgc_pose.matching import Matcher, MatchResult, select_matches
from dgc_pose.pose import solve_pair
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
        for method in self.methods:
            matcher, cameras = self.matchers[method.matcher], method.cameras.cameras(pair)
            options, everywhere_px = method.estimation, (np.nan, np.nan)
            if pair.truth.seed:
                options = replace(options, seed=pair_seed(options.seed, *pair.truth.seed))
            start = time.perf_counter()
            found = _matches(method, matcher, pair, cameras, options)
            seconds = time.perf_counter() - start
            dense = found.correspondence_map
            if issubclass(self.pairs.kind, MapScore) and dense is not None:
                everywhere_px = epipolar_errors(pair.truth, dense.map, dense.grid)
            yield MatchedPair(
                kind=self.pairs.kind,
                method=method.name,
                truth=pair.truth,
                cameras=cameras,
                matches=found.matches,
                map_matches=None if method.everywhere else found.map_matches,
                everywhere_px=everywhere_px,
                options=options,
                match_seconds=seconds,
            )


def _matches(
    method: Method,
    matcher: Matcher,
    pair: PosedPair,
    cameras: tuple[Camera, Camera],
    options: EstimationOptions,
) -> MatchResult:
    """The matches that the pose of a method is of."""
    if not method.everywhere:
        solved = solve_pair(pair.image1, pair.image2, cameras, matcher, options)
        return MatchResult(solved.matches, solved.correspondence_map)
    dense = matcher.match(pair.image1, pair.image2).correspondence_map
    if dense is None:
        raise InputError(f"{method.name}: {matcher.name} makes no map")
    everywhere = replace(method.matcher.matching, matchability=0.0)
    return MatchResult(select_matches(dense, everywhere, min_share=0.0), dense)
