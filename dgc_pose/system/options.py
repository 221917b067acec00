"""Fields of option dataclasses: default, help text and allowed values stand in one place.

A field made by `option` is checked by `check_options`, and the commands make a command-line option
of it, if it has a help text (`dgc_pose.cli.options`).
"""

import math
from collections.abc import Callable
from dataclasses import MISSING, Field, dataclass, field, fields
from functools import cache
from numbers import Integral, Real
from types import UnionType
from typing import Any, Literal, Union, get_args, get_origin, get_type_hints

from dgc_pose.errors import ArgumentName, InputError

MAX_SEED = 2**63 - 1  # what torch takes

# Of a command's help, in the order that they have there.
Section = Literal[
    "cameras", "output", "options", "scale", "reconstruction", "matching", "estimation", "advanced"
]

_KEY = "option"
_NUMBERS: dict[type, type] = {int: Integral, float: Real}  # those of NumPy too
_TYPE_NAMES = {int: "an integer", float: "a number", bool: "true or false", str: "a text"}


@dataclass(frozen=True)
class OptionInfo:
    """The facts of an option beside its type and default."""

    help: str = ""  # empty: not on the command line
    flag: str | None = None  # as on the command line; None: made of the field's name
    metavar: str | None = None
    parse: Callable[[str], Any] | None = None  # makes the value of its text, or raises InputError
    text: str | None = None  # the default as a user would write it, if the option is parsed
    min: float | None = None  # least allowed value
    above: float | None = None  # the value must be larger
    max: float | None = None  # largest allowed value
    type: Any = None  # of click, for a text that is more than that, such as an output's path
    section: Section = "options"  # of the command's help


def option(default: Any = MISSING, help: str = "", **info: Any) -> Any:
    """A dataclass field with an `OptionInfo`. Without a default the option is required."""
    return field(default=default, metadata={_KEY: OptionInfo(help, **info)})


def option_info(of: Field[Any]) -> OptionInfo | None:
    """The `OptionInfo` of a dataclass field; None if it was not made by `option`."""
    info: OptionInfo | None = of.metadata.get(_KEY)
    return info


@cache
def field_types(cls: Any) -> dict[str, tuple[Any, bool]]:
    """For each field of a dataclass its type, without "or None", and whether None is allowed.

    The types must be importable at run time, not under TYPE_CHECKING alone.
    """
    types = {}
    for name, hint in get_type_hints(cls).items():
        kinds = [kind for kind in get_args(hint) if kind is not type(None)]
        only = get_origin(hint) in (Union, UnionType) and len(kinds) == 1
        types[name] = (kinds[0], True) if only else (hint, False)
    return types


def check_options(options: Any) -> None:
    """Raise InputError, naming the field, if a value has another type, or lies outside its range or
    Literal.

    For `__post_init__` of option dataclasses. None passes if the type has it.
    """
    cls: Any = type(options)
    for of in fields(options):
        name, info, value = ArgumentName(of.name), option_info(of), getattr(options, of.name)
        kind, optional = field_types(cls)[name]
        if value is None and (optional or of.default is None):
            continue
        check_type(value, kind, name)
        if get_origin(kind) is Literal and value not in get_args(kind):
            choices = ", ".join(map(str, get_args(kind)))
            raise InputError(name, f"must be one of {choices}, not {value!r}")
        if isinstance(value, float) and math.isnan(value):
            raise InputError(name, "must be a number, not nan")
        if info is not None:
            low = info.min is not None and value < info.min
            low = low or (info.above is not None and value <= info.above)
            if low or (info.max is not None and value > info.max):
                bounds = {"at least": info.min, "above": info.above, "at most": info.max}
                texts = (f"{words} {n}" for words, n in bounds.items() if n is not None)
                raise InputError(name, f"must be {' and '.join(texts)}, not {value}")


def check_type(value: Any, kind: Any, name: str) -> None:
    """Raise InputError, naming the argument, for a value of another type than bool, int, float,
    str, Path, a class or a tuple of these."""
    kinds: tuple[Any, ...] = (kind,)
    parts = (value,)
    if get_origin(kind) in (Union, UnionType):
        kinds = get_args(kind)
    elif get_origin(kind) is tuple:
        inner = get_args(kind)
        if not isinstance(value, tuple) or inner[-1] is not Ellipsis and len(inner) != len(value):
            words = "a tuple" if inner[-1] is Ellipsis else f"a tuple of {len(inner)}"
            raise InputError(ArgumentName(name), f"must be {words}, not {value!r}")
        kinds, parts = inner[:1], value
    if not all(isinstance(kind, type) for kind in kinds):
        return
    allowed = tuple(_NUMBERS.get(kind, kind) for kind in kinds)
    for part in parts:
        if not isinstance(part, allowed) or (isinstance(part, bool) and bool not in kinds):
            names = " or ".join(_TYPE_NAMES.get(kind, f"a {kind.__name__}") for kind in kinds)
            shown = repr(part) if isinstance(part, str | Real | None) else type(part).__name__
            raise InputError(ArgumentName(name), f"must be {names}, not {shown}")
