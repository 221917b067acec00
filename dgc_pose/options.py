"""Fields of option dataclasses: default, help text and allowed values stand in one place.

A field made by `option` is checked by `check_options`, and the commands make a command-line option
of it, if it has a help text (`dgc_pose.cli.dataclass_options`).
"""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import MISSING, Field, dataclass, field, fields
from functools import cache
from types import UnionType
from typing import Any, Literal, Union, get_args, get_origin, get_type_hints

from dgc_pose.errors import InputError

_KEY = "option"


@dataclass(frozen=True)
class OptionInfo:
    """What is known of an option beside its type and default."""

    help: str  # empty: not on the command line
    flag: str | None  # as on the command line; None: made of the field's name
    metavar: str | None
    parse: Callable[[str], Any] | None  # the value from the text of the command line
    text: str | None  # the default as text, if the option is parsed
    min: float | None  # least allowed value
    above: float | None  # the value must be larger
    max: float | None  # largest allowed value


def option(
    default: Any = MISSING,
    help: str = "",
    *,
    flag: str | None = None,
    metavar: str | None = None,
    parse: Callable[[str], Any] | None = None,
    text: str | None = None,
    min: float | None = None,
    above: float | None = None,
    max: float | None = None,
) -> Any:
    """A dataclass field with what the command line and `check_options` need to know of it.

    Without a default the option is required. `parse` makes the value of the option's text and
    raises InputError for a wrong one; then `text` is the default as a user would write it.
    """
    info = OptionInfo(help, flag, metavar, parse, text, min, above, max)
    return field(default=default, metadata={_KEY: info})


def option_info(of: Field[Any]) -> OptionInfo | None:
    """What `option` was given for a dataclass field; None for other fields."""
    info: OptionInfo | None = of.metadata.get(_KEY)
    return info


@cache
def field_types(cls: Any) -> dict[str, tuple[Any, bool]]:
    """For each field of a dataclass its type, without "or None", and whether None is allowed.

    The types must be importable at run time, not under TYPE_CHECKING alone.
    """
    hints = get_type_hints(cls)
    return {one.name: _without_none(hints[one.name]) for one in fields(cls)}


def check_options(options: Any) -> None:
    """Raise InputError, naming the field, if a value lies outside its range or Literal.

    For `__post_init__` of option dataclasses. Checks the fields made by `option`; None passes.
    """
    cls: Any = type(options)
    types = field_types(cls)
    for one in fields(options):
        info, value = option_info(one), getattr(options, one.name)
        if info is None or value is None:
            continue
        kind = types[one.name][0]
        if get_origin(kind) is Literal and value not in get_args(kind):
            names = ", ".join(map(str, get_args(kind)))
            raise InputError(f"{one.name} must be one of {names}, not {value!r}")
        if not _in_range(info, value):
            order = "be ascending and " if isinstance(value, tuple) else ""
            raise InputError(f"{one.name} must {order}{_range(info)}, not {value}")


def _in_range(info: OptionInfo, value: Any) -> bool:
    """Whether a number, or each of an ascending range (low, high), is finite and within bounds."""
    if info.min is None and info.above is None and info.max is None:
        return True
    values = value if isinstance(value, tuple) else (value,)
    return list(values) == sorted(values) and all(
        math.isfinite(one)
        and (info.min is None or one >= info.min)
        and (info.above is None or one > info.above)
        and (info.max is None or one <= info.max)
        for one in values
    )


def _range(info: OptionInfo) -> str:
    low, high = info.min, info.max
    if info.above is not None:
        text = "be positive" if info.above == 0 else f"be above {info.above:g}"
        return f"{text} and finite" if high is None else f"{text} and at most {high:g}"
    if low is not None and high is not None:
        return f"lie in [{low:g}, {high:g}]"
    if low is not None:
        return "not be negative" if low == 0 else f"be at least {low:g}"
    return f"be at most {high:g}"


def _without_none(hint: Any) -> tuple[Any, bool]:
    if get_origin(hint) in (Union, UnionType):
        kinds = [kind for kind in get_args(hint) if kind is not type(None)]
        if len(kinds) == 1:
            return kinds[0], True
    return hint, False
