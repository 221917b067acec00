"""The loop of every pose benchmark: match the pairs of a data set, estimate, compare.

Pairs are matched in this process, batch by batch; poses are estimated here or in other processes.
"""

from __future__ import annotations

import hashlib
import json
import time
from collections import deque
from collections.abc import Callable, Iterator, Mapping, Sequence
from concurrent.futures import Future
from contextlib import nullcontext
from dataclasses import asdict, dataclass, replace
from functools import partial
from itertools import chain, islice
from typing import Any, Generic

from dgc_pose.benchmarks.methods import (
    MatchingPass,
    Method,
    Passes,
    load_passes,
    parse_methods,
)
from dgc_pose.benchmarks.posed_pairs import PairSet, PosedPair
from dgc_pose.benchmarks.scores import Score
from dgc_pose.benchmarks.scoring import MatchedPair, map_errors, pair_seed, score
from dgc_pose.benchmarks.summary import by_method
from dgc_pose.cameras.camera import Camera
from dgc_pose.estimation import EstimationOptions
from dgc_pose.matchers import MatcherOptions
from dgc_pose.matches import Matches
from dgc_pose.matching import MatchResult
from dgc_pose.pose import pose_of_pair
from dgc_pose.system.options import check_options, option
from dgc_pose.system.processes import process_pools


def score_pairs(
    pairs: PairSet[Score], methods: Sequence[str], *, device: str = "auto"
) -> dict[str, list[Score]]:
    """The records of methods on a data set, of each pair in order, by the method's specification.

    methods: see `parse_methods`. device: of networks. Raises what `Evaluation.run` raises, and
    InputError or WeightsError for a method that cannot be used.
    """
    parsed = parse_methods(methods)
    evaluation = Evaluation(pairs, parsed, load_passes(parsed, device=device))
    return by_method(chain.from_iterable(evaluation.run()))


@dataclass(frozen=True)
class Evaluation(Generic[Score]):
    """Methods on a data set. Raises InputError, naming the field, for a number below 1."""

    pairs: PairSet[Score]
    methods: Sequence[Method]
    passes: Passes
    workers: int = option(1, min=1)  # processes that estimate poses; one is this process
    batch: int = option(1, min=1)  # pairs that a network matches together

    def __post_init__(self) -> None:
        check_options(self)

    def run(self, first: int = 0) -> Iterator[list[Score]]:
        """For each pair from number `first` on, in order, a record a method.

        The same whatever `first` and `workers`: batches begin at the same pairs, and the seed of a
        pair depends on nothing else.

        Raises what reading a pair raises, and DgcPoseError if a process ends before its work.
        """
        number = first - first % self.batch
        pairs = self.pairs.read(number)
        waiting: deque[list[Future[Score]]] = deque()
        pools = nullcontext(_at_once) if self.workers == 1 else process_pools([self.workers])
        with pools as submit:
            while posed := list(islice(pairs, self.batch)):
                for by_method in self._match(posed):
                    if number >= first:
                        waiting.append([submit(0, score, matched) for matched in by_method])
                    number += 1
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
            "methods": [_settings(method) for method in self.methods],
            "weights": {
                options.weights: matching.matcher.fingerprint
                for options, matching in self.passes.items()
                if matching.matcher.fingerprint is not None
            },
            "batch": self.batch,
            "device": device,
        }

    def _match(self, batch: Sequence[PosedPair]) -> list[list[MatchedPair[Score]]]:
        """The pairs of a batch, each by every method."""
        keys = dict.fromkeys(method.matching_pass for method in self.methods)
        results = {key: _results(self.passes[key], batch) for key in keys}
        return [
            list(self._of_pair(pair, {key: results[key][number] for key in keys}))
            for number, pair in enumerate(batch)
        ]

    def _of_pair(
        self, pair: PosedPair, results: Mapping[MatcherOptions, _Result]
    ) -> Iterator[MatchedPair[Score]]:
        selected: dict[tuple[MatcherOptions, bool], tuple[MatchResult, float]] = {}
        for method in self.methods:
            mapped = results[method.matching_pass]
            whole = partial(self._selected, selected, method, pair, mapped)
            cameras, options = method.cameras.cameras(pair), _seeded(method, pair)
            final, seconds = self._final(method, pair, cameras, options, whole)
            yield MatchedPair(
                kind=self.pairs.kind,
                method=method.name,
                truth=pair.truth,
                cameras=cameras,
                matches=final.matches,
                map_matches=None if method.everywhere else final.map_matches,
                everywhere_px=mapped.everywhere_px,
                options=options,
                match_seconds=seconds,
            )

    def _selected(
        self,
        selected: dict[tuple[MatcherOptions, bool], tuple[MatchResult, float]],
        method: Method,
        pair: PosedPair,
        mapped: _Result,
    ) -> tuple[MatchResult, float]:
        """All the matches of a method, and the seconds that they took: of the map, of selection and
        of refinement. `selected` has those of the pair that are there."""
        key = (method.matcher, method.everywhere)
        if key not in selected:
            start = time.perf_counter()
            matching = self.passes[method.matching_pass]
            result = matching.selected(method, pair.image1, pair.image2, mapped.matched)
            selected[key] = result, mapped.seconds + time.perf_counter() - start
        return selected[key]

    def _final(
        self,
        method: Method,
        pair: PosedPair,
        cameras: tuple[Camera, Camera],
        options: EstimationOptions,
        whole: Callable[[], tuple[MatchResult, float]],
    ) -> tuple[MatchResult, float]:
        """The matches that the pose is of at last, and the seconds until they were there, also
        those of poses before. whole: all the matches, and their seconds."""
        refiner = self.passes[method.matching_pass].refiner(method)
        if refiner is None:
            return whole()
        start = end = time.perf_counter()
        elsewhere = 0.0

        def match() -> MatchResult:
            nonlocal elsewhere
            begun = time.perf_counter()
            result, seconds = whole()
            elsewhere += seconds - (time.perf_counter() - begun)
            return result

        def matched(matches: Matches) -> None:
            nonlocal end
            end = time.perf_counter()

        _, final = pose_of_pair(
            refiner, pair.image1, pair.image2, *cameras, options, whole=match, matched=matched
        )
        return final, end - start + elsewhere


@dataclass(frozen=True)
class _Result:
    """Of one pair and one matching pass."""

    matched: MatchResult
    everywhere_px: tuple[float, float]  # median and mean D_e over all pixels, NaN without a map
    seconds: float  # the mean over the batch


def _seeded(method: Method, pair: PosedPair) -> EstimationOptions:
    """The estimation of a method with the seed of the pair, if the pair has one."""
    words, options = pair.truth.seed, method.estimation
    return replace(options, seed=pair_seed(options.seed, *words)) if words else options


def _settings(method: Method) -> dict[str, Any]:
    """All that a method's records depend on; the list's own cameras go without saying."""
    settings = asdict(method)
    if not method.cameras.reports:
        del settings["cameras"]
    return settings


def _results(matching: MatchingPass, batch: Sequence[PosedPair]) -> list[_Result]:
    start = time.perf_counter()
    results = matching.matcher.match_batch([(pair.image1, pair.image2) for pair in batch])
    seconds = (time.perf_counter() - start) / len(batch)
    return [
        _Result(matched, map_errors(pair.truth, matched.correspondence_map), seconds)
        for matched, pair in zip(results, batch, strict=True)
    ]


def _at_once(pool: int, work: Any, *items: Any) -> Future[Any]:
    future: Future[Any] = Future()
    future.set_result(work(*items))
    return future
