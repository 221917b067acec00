"""The methods of the DTU benchmark by name: networks, SIFT, optical flows, and files of others.

`NAME` takes the matches that a method trusts (matchability, or the flow back agreeing); `NAME/all`
takes every pixel of image 2 that the same map places inside image 1. Both share one matching pass.
"""

from __future__ import annotations

import hashlib
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import cast

from dgc_pose.benchmarks.dtu.external import ExternalMatches
from dgc_pose.benchmarks.dtu.flow import FLOWS, FlowMatcher, FlowName
from dgc_pose.benchmarks.dtu.protocols import ShownPair
from dgc_pose.benchmarks.methods import SIFT, load_methods
from dgc_pose.errors import InputError
from dgc_pose.matches import Matches
from dgc_pose.matching import CorrespondenceMap, DenseMatcher, MatchingOptions
from dgc_pose.matching.dense import FeatureCache, feature_cache
from dgc_pose.matching.selection import select_matches
from dgc_pose.matching.sift import SiftMatcher, key_point_cache
from dgc_pose.network.weights import shipped
from dgc_pose.refinement import RefinementOptions, Refiner
from dgc_pose.refinement.native import native_cache

EVERYWHERE = "/all"

Found = CorrespondenceMap | Matches
# Matches several pairs; what it finds is in pixels of the images shown.
Engine = Callable[[Sequence[ShownPair]], list[Found]]


@dataclass(frozen=True)
class Method:
    """One row of the summary."""

    name: str
    engine: str  # what matches: methods may share it
    everywhere: bool = False  # whether every pixel counts, whatever the matchability


@dataclass(frozen=True)
class Engines:
    """What the methods match with."""

    by_name: Mapping[str, Engine]
    caches: Mapping[str, FeatureCache]  # of those that are networks
    fingerprints: Mapping[str, str]  # of the networks' weights
    refiners: Mapping[str, Refiner]  # of the networks whose matches are to be refined


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
    *,
    device: str,
    options: MatchingOptions,
    refinement: RefinementOptions | None = None,
) -> Engines:
    """Load what the methods match with, each once.

    refinement: of the networks' matches; None for those of their maps as they are.

    Raises WeightsError where weights cannot be loaded.
    """
    wanted = list(dict.fromkeys(method.engine for method in methods))
    ours = [name for name in wanted if name not in (*external, *FLOWS)]
    by_name: dict[str, Engine] = {}
    caches: dict[str, FeatureCache] = {}
    fingerprints: dict[str, str] = {}
    refiners: dict[str, Refiner] = {}
    matchers = load_methods(ours, device=device, options=options) if ours else {}
    for name, matcher in matchers.items():
        if isinstance(matcher, DenseMatcher):
            matcher.cache = caches[name] = feature_cache()
            fingerprints[name] = _fingerprint(matcher)
            by_name[name] = _network(matcher)
            if refinement is not None:
                refiners[name] = Refiner(matcher, refinement, native_cache())
        else:
            by_name[name] = _sift(SiftMatcher(cache=key_point_cache()))
    for name in wanted:
        if name in external:
            by_name[name] = _external(ExternalMatches(external[name]))
        elif name in FLOWS:
            by_name[name] = _flow(FlowMatcher(cast(FlowName, name)))
    return Engines(by_name, caches, fingerprints, refiners)


def matches_of(method: Method, found: Found, options: MatchingOptions) -> Matches:
    """The matches that go into the pose, of what the method's engine found."""
    if isinstance(found, Matches):
        if method.everywhere:
            raise InputError(
                f"{method.name}: the files hold points and no map, so {EVERYWHERE} says nothing"
            )
        return found
    if method.everywhere:
        options = replace(options, matchability=0.0, cycle_px=None, min_share=0.0)
    return select_matches(found, options)


def refined(
    method: Method, engines: Engines, shown: ShownPair, found: Found, matches: Matches
) -> Matches:
    """The matches on the images shown, where the method's engine refines; all pixels, as `/all`
    takes them, are never refined."""
    refiner = engines.refiners.get(method.engine)
    if refiner is None or method.everywhere or isinstance(found, Matches):
        return matches
    return refiner.refine(shown.image1, shown.image2, found, matches)


def _fingerprint(matcher: DenseMatcher) -> str:
    """Of weights, so that a run is not gone on with by others of the same name."""
    digest = hashlib.sha256()
    for key, value in sorted(matcher.net.state_dict().items()):
        digest.update(key.encode() + value.cpu().numpy().tobytes())
    return digest.hexdigest()[:16]


def _network(matcher: DenseMatcher) -> Engine:
    def find(shown: Sequence[ShownPair]) -> list[Found]:
        return [*matcher.correspond_batch([(one.image1, one.image2) for one in shown])]

    return find


def _sift(matcher: SiftMatcher) -> Engine:
    return lambda shown: [matcher.match(one.image1, one.image2) for one in shown]


def _flow(matcher: FlowMatcher) -> Engine:
    return lambda shown: [matcher.correspond(one.image1, one.image2) for one in shown]


def _external(folder: ExternalMatches) -> Engine:
    return lambda shown: [folder.find(one) for one in shown]
