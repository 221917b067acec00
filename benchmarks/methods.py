"""Methods by specification: what matches, and with which options.

A specification is `NAME[:KEY=VALUE...]`, as `dgcm-lite0:refine=features:align=false`. NAME is that
of a matcher (see `load_matcher`) or of stored matches. `NAME/all` takes every pixel that the map of
NAME sends into image 1, whatever its matchability, and refines nothing. KEY is a field of
`MatchingOptions`, `RefinementOptions` or `EstimationOptions`, or of the options within them, and is
set wherever it occurs; `refine` is the source of refinement, or none, and `refine_pose` is
`EstimationOptions.refine`. Methods that differ in selection, refinement or estimation alone share
one matching pass.
"""

from __future__ import annotations

import re
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field, is_dataclass, replace
from pathlib import Path
from typing import Any, Literal, TypeVar, get_args, get_origin

from dgc_pose.errors import InputError
from dgc_pose.estimation import EstimationOptions
from dgc_pose.images.image import Image
from dgc_pose.matchers import CLASSICAL, SIFT, MatcherCaches, load_matcher, refined
from dgc_pose.matches import Matches
from dgc_pose.matching import Matcher, MatchingOptions, MatchResult, select_matches
from dgc_pose.matching.dense import DenseMatcher, load_dense_matcher
from dgc_pose.matching.files import FileMatcher
from dgc_pose.matching.texture import textured
from dgc_pose.network.stored import shipped
from dgc_pose.refinement import RefinementOptions, Refiner
from dgc_pose.refinement.source import MapMatches
from dgc_pose.runtime.load import RuntimeName
from dgc_pose.system.options import field_types

EVERYWHERE = "/all"
NO_REFINEMENT = "none"
_KEYS = {"source": "refine", "refine": "refine_pose"}  # of fields that are not called as their key

_SETTING = re.compile(r"[a-z]\w*=")

Stem = Callable[[str, str], str]  # see FileMatcher
PassKey = tuple[str, MatchingOptions]  # an engine, and the options that its map depends on
Options = TypeVar("Options")


@dataclass(frozen=True)
class MethodOptions:
    """What a specification changes."""

    matching: MatchingOptions = field(default_factory=MatchingOptions)
    refinement: RefinementOptions | None = None  # of a network's matches; None for those of its map
    estimation: EstimationOptions = field(default_factory=EstimationOptions)


@dataclass(frozen=True)
class Method:
    """One row of the summary."""

    name: str  # the specification
    engine: str  # what matches
    everywhere: bool = False  # whether every pixel counts, whatever the matchability
    options: MethodOptions = field(default_factory=MethodOptions)

    @property
    def key(self) -> PassKey:
        """What the dense map depends on; methods that agree in it share a matching pass."""
        own = self.options.matching
        cycle_px = None if own.cycle_px is None else 1.0
        return self.engine, MatchingOptions(
            cycle_px=cycle_px, search_below=own.search_below, finest=own.finest
        )


@dataclass(frozen=True)
class Engine:
    """One matching pass."""

    matcher: Matcher
    refiners: Mapping[RefinementOptions, Refiner]

    def matches(self, method: Method, image1: Image, image2: Image, found: MatchResult) -> Matches:
        """The matches that go into the pose, of what the matcher found in two images."""
        if found.correspondence_map is not None:
            selected = select_matches(found.correspondence_map, method.options.matching)
            if not method.everywhere:
                selected = textured(selected, image1, image2)
            found = replace(found, matches=selected)
        elif method.everywhere:
            raise InputError(
                f"{method.name}: the files hold points and no map, so {EVERYWHERE} says nothing"
            )
        if method.options.refinement is None:
            return found.matches
        return self.refiners[method.options.refinement].refine(image1, image2, found).matches


@dataclass(frozen=True)
class Engines:
    """What the methods match with."""

    passes: Mapping[PassKey, Engine]
    caches: Mapping[str, MatcherCaches]  # by engine, of networks whose features are kept

    def of(self, method: Method) -> Engine:
        """The matching pass of a method."""
        return self.passes[method.key]

    @property
    def fingerprints(self) -> dict[str, str]:
        """Of the networks' weights, by engine: a run is only resumed with the same weights."""
        found = {name: engine.matcher.fingerprint for (name, _), engine in self.passes.items()}
        return {name: digits for name, digits in found.items() if digits is not None}


def parse_methods(
    specifications: Sequence[str],
    defaults: MethodOptions | None = None,
    stored: Sequence[str] = (),
) -> list[Method]:
    """The methods that specifications stand for.

    Args:
        specifications: as described at the top of this file.
        defaults: the options of what a specification leaves open; only networks are refined.
        stored: names of stored matches; those that no specification names become methods, last.

    Raises InputError for none, for one that is given twice, that is malformed or has an option out
    of range, for `/all` of key points, and for a name of `stored` that is taken.
    """
    defaults = defaults or MethodOptions()
    for name in stored:
        if name in (*CLASSICAL, *shipped()):
            raise InputError(f"--matches {name}: a method of that name is there already")
    for text in specifications:
        if specifications.count(text) > 1:
            raise InputError(f"the method {text!r} is named twice")
    methods = [_parse(text, defaults, stored) for text in specifications]
    named = {method.engine for method in methods}
    methods += [_parse(name, defaults, stored) for name in stored if name not in named]
    if not methods:
        raise InputError("no methods named")
    return methods


def load_engines(
    methods: Sequence[Method],
    *,
    device: str,
    runtime: RuntimeName = "auto",
    stored: Mapping[str, Path] | None = None,
    stem: Stem | None = None,
    keep_features: bool = False,
) -> Engines:
    """Load what the methods match with, each network once.

    stored: folders of stored matches by name, whose files `stem` names. keep_features: whether what
    is computed of an image serves later pairs of it, so that times are those of a list of pairs.

    Raises WeightsError if weights cannot be loaded, InputError for an option that does not fit.
    """
    folders = stored or {}
    caches: dict[str, MatcherCaches] = {}
    networks: dict[str, DenseMatcher] = {}
    passes: dict[PassKey, Engine] = {}
    for name, options in dict.fromkeys(method.key for method in methods):
        own = [one.options for one in methods if one.key == (name, options)]
        wanted = {one.refinement for one in own if one.refinement is not None}
        kept = caches.setdefault(name, MatcherCaches()) if keep_features else None
        if name in folders:
            assert stem is not None
            matcher: Matcher = FileMatcher(folders[name], stem, name, options)
        elif name in CLASSICAL:
            matcher = load_matcher(name, matching=options, caches=kept)
        else:
            cache, native = (None, None) if kept is None else (kept.features, kept.native)
            if name in networks:
                dense = DenseMatcher(networks[name].engine, options, cache)
            else:
                dense = load_dense_matcher(
                    name, device=device, runtime=runtime, options=options, cache=cache
                )
                networks[name] = dense
            refiners = {one: refined(dense, one, native) for one in wanted}
            passes[name, options] = Engine(dense, refiners)
            continue
        passes[name, options] = Engine(matcher, {one: _refiner(matcher, one) for one in wanted})
    return Engines(passes, {name: kept for name, kept in caches.items() if name in networks})


def _refiner(matcher: Matcher, options: RefinementOptions) -> Refiner:
    """Refinement of a matcher without a network."""
    if options.source == "map":
        return Refiner(matcher, (MapMatches(),), options.alignment)
    raise InputError(f"{matcher.name}: refine={options.source} needs the features of a network")


def _parse(text: str, defaults: MethodOptions, stored: Sequence[str]) -> Method:
    parts = text.split(":")
    # A path may hold colons: the settings are what follows the last part that is none.
    first = 1 + max(k for k, part in enumerate(parts) if not k or not _SETTING.match(part))
    name = ":".join(parts[:first])
    settings = dict(part.split("=", 1) for part in parts[first:])
    engine = name.removesuffix(EVERYWHERE)
    if not engine:
        raise InputError(f"the method {text!r} is none")
    if engine == SIFT and name != SIFT:
        raise InputError(f"{text}: {SIFT} has key points alone, so {EVERYWHERE} says nothing")
    if engine in (*CLASSICAL, *stored):
        defaults = replace(defaults, refinement=None)
    if settings.get("refine") == NO_REFINEMENT:
        del settings["refine"]
        defaults = replace(defaults, refinement=None)
    elif "refine" in settings:
        defaults = replace(defaults, refinement=defaults.refinement or RefinementOptions())
    used: set[str] = set()
    try:
        options = _changed(defaults, settings, used)
    except InputError as error:
        raise InputError(f"{text}: {error}") from None
    for key in settings:
        if key not in used:
            raise InputError(f"{text}: no option {key}")
    if name != engine:
        matching = replace(options.matching, matchability=0.0, cycle_px=None, min_share=0.0)
        options = replace(options, matching=matching, refinement=None)
    return Method(text, engine, name != engine, options)


def _changed(options: Options, settings: Mapping[str, str], used: set[str]) -> Options:
    """Options (a dataclass) with settings put in wherever a field has their name, as well in the
    dataclasses within; the names found are added to `used`."""
    cls: Any = type(options)
    changes: dict[str, Any] = {}
    for name, (kind, optional) in field_types(cls).items():
        value, key = getattr(options, name), _KEYS.get(name, name)
        if is_dataclass(value):
            changes[name] = _changed(value, settings, used)
        elif key in settings:
            used.add(key)
            try:
                changes[name] = _value(settings[key], kind, optional)
            except (KeyError, ValueError):
                raise InputError(f"{key} cannot be {settings[key]!r}") from None
    return replace(options, **changes)  # type: ignore[type-var]


def _value(text: str, kind: Any, optional: bool) -> Any:
    """A number, true or false, a word of a Literal, or none. Raises ValueError or KeyError."""
    if optional and text == "none":
        return None
    if get_origin(kind) is Literal:
        return {str(word): word for word in get_args(kind)}[text]
    return {"true": True, "false": False}[text] if kind is bool else kind(text)
