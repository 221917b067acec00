"""Methods by specification: what matches, and with which options.

A specification is `NAME[:KEY=VALUE...]`, as `dgcm-lite0:refine=none:max_matches=500`. NAME is that
of a matcher (see `load_matcher`), `dis` (`flow.py`), or that of stored matches. `NAME/all` takes
every pixel that the map of NAME sends into image 1, whatever its matchability, and refines nothing.
KEY is a field of `MatchingOptions` or `EstimationOptions`, or of the options within them, and is
set in each of them that has it; `refine` is `MatchingOptions.aligned`, `refine_pose` is
`EstimationOptions.refine`.
`K`, `K_scale` and the like are the fields of `CameraTrial`, as in `dgcm-lite0:K=auto:shared`.
"""

import re
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, fields, is_dataclass, replace
from pathlib import Path
from typing import Any, Literal, TypeVar, get_args, get_origin

from dgc_pose.benchmarks.camera_trial import CameraTrial
from dgc_pose.benchmarks.flow import NAME as FLOW
from dgc_pose.benchmarks.flow import FlowMatcher
from dgc_pose.benchmarks.stored_matches import FileMatcher, Names
from dgc_pose.errors import InputError
from dgc_pose.estimation import EstimationOptions
from dgc_pose.matchers import MatcherOptions, RuntimeName
from dgc_pose.matching import Matcher
from dgc_pose.runtime.engine import Engine
from dgc_pose.system.options import field_types

EVERYWHERE = "/all"
# Of fields whose key is another word
_KEYS = {"aligned": "refine", "refine": "refine_pose"} | {
    field.name: field.name.capitalize() for field in fields(CameraTrial)
}
_SETTING = re.compile(r":(?=[A-Za-z]\w*=)")  # begins with; a path and K=auto:two hold colons, too

Options = TypeVar("Options")


@dataclass(frozen=True)
class Method:
    """One row of the summary."""

    name: str  # the specification
    matcher: MatcherOptions
    estimation: EstimationOptions
    cameras: CameraTrial
    everywhere: bool = False  # whether every pixel counts, whatever the matchability


def parse_methods(
    specifications: Sequence[str],
    matcher: MatcherOptions | None = None,
    estimation: EstimationOptions | None = None,
    stored: Sequence[str] = (),
    cameras: CameraTrial | None = None,
) -> list[Method]:
    """The methods that specifications stand for.

    Args:
        specifications: as described at the top of this file.
        matcher, estimation: what a specification leaves open; only networks are refined then.
        stored: names of stored matches, before any other of that name; those that no
            specification names become methods, last.
        cameras: for what a specification leaves open of the method's cameras.

    Raises InputError for none, and for one that is given twice, has an option out of range, or
    is `/all` of key points.
    """
    for text in specifications:
        if specifications.count(text) > 1:
            raise InputError(f"the method {text!r} is named twice")
    defaults = Method(
        "", matcher or MatcherOptions(), estimation or EstimationOptions(), cameras or CameraTrial()
    )
    methods = [_parse(text, defaults, stored) for text in specifications]
    named = {method.matcher.weights for method in methods}
    methods += [_parse(name, defaults, stored) for name in stored if name not in named]
    if not methods:
        raise InputError("no methods named")
    return methods


def load_matchers(
    methods: Sequence[Method],
    *,
    device: str,
    runtime: RuntimeName = "auto",
    stored: Mapping[str, Mapping[Names, Path]] | None = None,
) -> list[Matcher]:
    """Load what each method matches with; a network is read once.

    stored: files of stored matches by name. Methods share nothing that is computed of an image,
    so that the seconds of each are its own.

    Raises WeightsError if weights cannot be loaded, InputError for an option that does not fit.
    """
    engines: dict[str, Engine | None] = {}
    matchers: list[Matcher] = []
    for options in (method.matcher for method in methods):
        if stored and options.weights in stored:
            files = stored[options.weights]
            matchers.append(FileMatcher(options.weights, files, options.matching))
            continue
        if options.weights == FLOW:
            matchers.append(FlowMatcher(options.matching))
            continue
        used = replace(options, device=device, runtime=runtime)
        matcher = used.load(engine=engines.get(options.weights))
        engines[options.weights] = matcher.engine
        matchers.append(matcher)
    return matchers


def _parse(text: str, defaults: Method, stored: Sequence[str]) -> Method:
    name, *words = _SETTING.split(text)
    settings = dict(word.split("=", 1) for word in words)
    weights = name.removesuffix(EVERYWHERE)
    matcher = replace(defaults.matcher, weights=weights)
    everywhere, network = name != weights, matcher.is_network and weights not in (FLOW, *stored)
    if everywhere and not matcher.is_network and weights not in stored:
        raise InputError(f"{text}: {weights} has key points alone, so {EVERYWHERE} says nothing")
    used: set[str] = set()
    aligned = matcher.matching.aligned if network and not everywhere else "none"
    try:
        matching = _changed(replace(matcher.matching, aligned=aligned), settings, used)
        estimation = _changed(defaults.estimation, settings, used)
        cameras = _changed(defaults.cameras, settings, used)
    except InputError as error:
        raise InputError(f"{text}: {error}") from None
    for key in settings:
        if key not in used:
            raise InputError(f"{text}: no option {key}")
    if not network and matching.aligned != "none":
        raise InputError(f"{text}: refine={matching.aligned} needs the features of a network")
    matcher = replace(matcher, matching=matching)
    return Method(text, matcher, estimation, cameras, everywhere)


def _changed(options: Options, settings: Mapping[str, str], used: set[str]) -> Options:
    """Options (a dataclass) with each setting put into every field of that name, also of the
    dataclasses within; those names are added to `used`."""
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
