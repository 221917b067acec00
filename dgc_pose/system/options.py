"""Fields of option dataclasses: default, help text and allowed values stand in one place.

A field made by `option` is checked by `check_options`, and the commands make a command-line option
of it, if it has a help text (`dgc_pose.cli.dataclass_options`).
"""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import MISSING, Field, dataclass, field, fields
from functools import cache
from numbers import Integral, Real
from types import UnionType
from typing import Any, Literal, Union, get_args, get_origin, get_type_hints

from dgc_pose.errors import InputError

MAX_SEED = 2**63 - 1  # what torch takes

_KEY = "option"
_NUMBERS: dict[type, type] = {int: Integral, float: Real}  # those of NumPy too


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
    type: Any = None  # of click, for a text that is more than that, such as an output's path


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
    type: Any = None,
) -> Any:
    """A dataclass field with what the command line and `check_options` need to know of it.

    Without a default the option is required. `parse` makes the value of the option's text and
    raises InputError for a wrong one; then `text` is the default as a user would write it.
    """
    info = OptionInfo(help, flag, metavar, parse, text, min, above, max, type)
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

    For `__post_init__` of option dataclasses. The types of all fields are checked, the ranges of
    those made by `option`; None passes if the type has it.
    """
    cls: Any = type(options)
    for one in fields(options):
        info, value = option_info(one), getattr(options, one.name)
        kind, optional = field_types(cls)[one.name]
        if value is None and (optional or one.default is None):
            continue
        check_type(value, kind, one.name)
        if get_origin(kind) is Literal and value not in get_args(kind):
            names = ", ".join(map(str, get_args(kind)))
            raise InputError(f"{one.name} must be one of {names}, not {value!r}")
        if info is not None and not _in_range(info, value):
            order = "be ascending and " if isinstance(value, tuple) else ""
            raise InputError(f"{one.name} must {order}{_range(info)}, not {value}")
        if isinstance(value, float) and math.isnan(value):
            raise InputError(f"{one.name} must be a number, not nan")


def check_type(value: Any, kind: Any, name: str) -> None:
    """Raise InputError, naming the argument, for a value of another type than bool, int, float,
    str, Path, a class or a tuple of these."""
    if get_origin(kind) is tuple:
        parts = get_args(kind)
        if not isinstance(value, tuple):
            raise InputError(f"{name} must be a tuple, not {value!r}")
        if parts[-1] is not Ellipsis and len(parts) != len(value):
            raise InputError(f"{name} must have {len(parts)} values, not {len(value)}")
        for part in value:
            check_type(part, parts[0], name)
        return
    if get_origin(kind) in (Union, UnionType):
        if not isinstance(value, get_args(kind)):
            names = " or ".join(_called(one) for one in get_args(kind))
            raise InputError(f"{name} must be {names}, not {value!r}")
        return
    if not isinstance(kind, type):
        return
    expected = _NUMBERS.get(kind, kind)
    if not isinstance(value, expected) or (isinstance(value, bool) and kind in (int, float)):
        given = (
            repr(value) if value is None or isinstance(value, str | Real) else type(value).__name__
        )
        raise InputError(f"{name} must be {_called(kind)}, not {given}")


def _called(kind: type) -> str:
    names = {int: "an integer", float: "a number", bool: "true or false", str: "a text"}
    return names.get(kind) or f"{'an' if kind.__name__[0] in 'AEIO' else 'a'} {kind.__name__}"


def _in_range(info: OptionInfo, value: Any) -> bool:
    """Whether a number, or each of an ascending range (low, high), is finite and within bounds."""
    if info.min is None and info.above is None and info.max is None:
        return True
    values = value if isinstance(value, tuple) else (value,)
    return list(values) == sorted(values) and all(
        (isinstance(one, int) or math.isfinite(one))  # a long integer is no float
        and (info.min is None or one >= info.min)
        and (info.above is None or one > info.above)
        and (info.max is None or one <= info.max)
        for one in values
    )


def _range(info: OptionInfo) -> str:
    low, high = (_number(bound) for bound in (info.min, info.max))
    if info.above is not None:
        text = "be positive" if info.above == 0 else f"be above {info.above:g}"
        return f"{text} and finite" if info.max is None else f"{text} and at most {high}"
    if info.min is not None and info.max is not None:
        return f"lie in [{low}, {high}]"
    if info.min is not None:
        return "not be negative" if info.min == 0 else f"be at least {low}"
    return f"be at most {high}"


def _number(bound: float | None) -> str:
    return f"{bound:g}" if isinstance(bound, float) else str(bound)


def _without_none(hint: Any) -> tuple[Any, bool]:
    if get_origin(hint) in (Union, UnionType):
        kinds = [kind for kind in get_args(hint) if kind is not type(None)]
        if len(kinds) == 1:
            return kinds[0], True
    return hint, False
