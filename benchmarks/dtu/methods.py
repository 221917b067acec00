"""The methods of the DTU benchmark by name: networks, SIFT, optical flows, and files of others.

`NAME` takes the matches that a method trusts (matchability, or the flow back agreeing); `NAME/all`
takes every pixel of image 2 that the same map places inside image 1. Both share one matching pass.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from pathlib import Path

from dgc_pose.benchmarks.dtu.entries import Entry
from dgc_pose.benchmarks.methods import SIFT
from dgc_pose.errors import InputError
from dgc_pose.matchers import MatcherCaches, load_matcher
from dgc_pose.matches import Matches
from dgc_pose.matching import Matcher, MatchingOptions, MatchResult
from dgc_pose.matching.dense import FeatureCache
from dgc_pose.matching.files import FileMatcher
from dgc_pose.matching.flow import FLOWS
from dgc_pose.matching.selection import select_matches
from dgc_pose.network.weights import shipped
from dgc_pose.refinement import RefinementOptions

EVERYWHERE = "/all"

@dataclass(frozen=True)
class Method:
    """One row of the summary."""

    name: str
    engine: str  # what matches: methods may share it
    everywhere: bool = False  # whether every pixel counts, whatever the matchability


@dataclass(frozen=True)
class Engines:
    """What the methods match with."""

    by_name: Mapping[str, Matcher]
    caches: Mapping[str, FeatureCache]  # of those that are networks
    fingerprints: Mapping[str, str]  # of the networks' weights


def parse_methods(names: Sequence[str], external: Sequence[str] = ()) -> list[Method]:
    """The methods that names stand for, the `external` ones last where they are not named.

    Raises InputError where there are none, one stands twice, one without a mask asks for `/all`, or
    an external one has the name of one of ours.
    """
    for name in external:
        if name in (SIFT, *FLOWS, *shipped()):
            raise InputError(f"--matches {name}: a method of that name is there already")
    engines = {name.removesuffix(EVERYWHERE) for name in names}
    methods: list[Method] = []
    for name in [*names, *(other for other in external if other not in engines)]:
        engine = name.removesuffix(EVERYWHERE)
        if engine == SIFT and name != SIFT:
            raise InputError(f"{name}: {SIFT} has key points alone, so {EVERYWHERE} says nothing")
        if not engine or any(method.name == name for method in methods):
            raise InputError(f"the method {name!r} " + ("is named twice" if engine else "is none"))
        methods.append(Method(name, engine, everywhere=engine != name))
    if not methods:
        raise InputError("no methods named")
    return methods


def load_engines(
    methods: Sequence[Method],
    external: Mapping[str, Path],
    stems: Mapping[tuple[str, str], str] | None = None,
    *,
    device: str,
    options: MatchingOptions,
    refinement: RefinementOptions | None = None,
) -> Engines:
    """Load what the methods match with, each once.

    stems: of the external files, see `pair_stems`. refinement: of the networks' matches; None for
    those of their maps as they are.

    Raises WeightsError where weights cannot be loaded.
    """
    by_name: dict[str, Matcher] = {}
    caches: dict[str, FeatureCache] = {}
    fingerprints: dict[str, str] = {}
    for name in dict.fromkeys(method.engine for method in methods):
        if name in external:
            by_name[name] = external_matcher(external[name], stems or {}, options)
            continue
        trusting = any(not one.everywhere for one in methods if one.engine == name)
        kept = MatcherCaches()
        by_name[name] = matcher = load_matcher(
            name,
            device=device,
            matching=options,
            refinement=refinement if trusting else None,
            caches=kept,
        )
        if matcher.fingerprint is not None:
            caches[name], fingerprints[name] = kept.features, matcher.fingerprint
    return Engines(by_name, caches, fingerprints)


def pair_stems(entries: Sequence[Entry]) -> dict[tuple[str, str], str]:
    """The names of the external files by the names of a pair's images."""
    return {
        (str(one.pair.path1), str(one.pair.path2)): f"scan{one.scene}_{one.view1}_{one.view2}"
        for one in entries
    }


def external_matcher(
    folder: Path, stems: Mapping[tuple[str, str], str], options: MatchingOptions | None = None
) -> FileMatcher:
    return FileMatcher(folder, lambda name1, name2: stems[name1, name2], options=options)


def matches_of(method: Method, found: MatchResult, options: MatchingOptions) -> Matches:
    """The matches that go into the pose, of what the method's engine found."""
    if not method.everywhere:
        return found.matches
    if found.correspondence_map is None:
        raise InputError(
            f"{method.name}: the files hold points and no map, so {EVERYWHERE} says nothing"
        )
    options = replace(options, matchability=0.0, cycle_px=None, min_share=0.0)
    return select_matches(found.correspondence_map, options)
