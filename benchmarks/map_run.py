"""Every method on every pair of a data set with known maps."""

from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass
from functools import partial
from typing import Any

from dgc_pose.benchmarks.map_comparison import compare, compare_matcher
from dgc_pose.benchmarks.map_scores import Comparison, PairScores, score_map
from dgc_pose.errors import ArgumentName, InputError
from dgc_pose.matchers import MatcherOptions
from dgc_pose.network.weights import choose_device, load_network
from dgc_pose.training.map_pairs import MapPairs

MapMethod = Callable[[MapPairs], list[Comparison]]  # of a batch, pair by pair


@dataclass(frozen=True, eq=False)
class MapCase:
    """A batch of 240x240 pairs, named."""

    group: str  # that the figures are averaged in
    names: tuple[str, ...]  # of each pair
    pairs: MapPairs


@dataclass(frozen=True, eq=False)
class MapSet:
    """A data set: pairs with known maps, batch by batch."""

    cases: Iterable[MapCase]
    total: int  # pairs
    facts: Mapping[str, Any]  # what the JSON has of the set


def load_map_methods(names: Sequence[str], *, device: str) -> dict[str, MapMethod]:
    """What makes the dense maps of methods, by name: bare networks, and matchers without one.

    Raises InputError for no names, one that is given twice, or a matcher of key points;
    WeightsError if weights cannot be loaded.
    """
    if not names:
        raise InputError("no methods named")
    chosen = choose_device(device)
    methods: dict[str, MapMethod] = {}
    for name in names:
        options = MatcherOptions(name)
        if name in methods:
            raise InputError(f"the method {name} is named twice")
        if not options.has_map:
            words = f"{name}: has key points alone and no dense map"
            raise InputError(ArgumentName("methods"), words)
        if options.is_network:
            methods[name] = partial(compare, load_network(name, chosen))
        else:
            methods[name] = partial(compare_matcher, options.load())
    return methods


def map_scores(cases: Iterable[MapCase], methods: Mapping[str, MapMethod]) -> Iterator[PairScores]:
    """The figures of each pair by each method, case by case."""
    for case in cases:
        for method, comparisons_of in methods.items():
            for name, comparison in zip(case.names, comparisons_of(case.pairs), strict=True):
                yield score_map(method, case.group, name, comparison)
