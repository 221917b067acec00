"""Fields of option dataclasses: default, help text and allowed values in one place.

`check_options` checks the fields made by `option`. From each field with a help text, the commands
make a command-line option (`dgc_pose.cli.options`).
"""

import math
from collections.abc import Callable
from dataclasses import MISSING, Field, dataclass, field, fields
from functools import cache
from numbers import Integral, Real
from types import UnionType
from typing import Any, Literal, Union, get_args, get_origin, get_type_hints

from dgc_pose.errors import ArgumentName, InputError

MAX_SEED = 2**63 - 1  # the largest that torch accepts

# Sections of a command's help, in their order.
Section = Literal[
    "cameras", "output", "options", "scale", "reconstruction", "matching", "estimation", "advanced"
]

_KEY = "option"
_NUMBERS: dict[type, type] = {int: Integral, float: Real}  # including NumPy's
_TYPE_NAMES = {int: "an integer", float: "a number", bool: "true or false", str: "a text"}


@dataclass(frozen=True)
class OptionInfo:
    """The properties of an option beside its type and default."""

    help: str = ""  # empty: not on the command line
    flag: str | None = None  # on the command line; None: derived from the field's name
    metavar: str | None = None
    parse: Callable[[str], Any] | None = None  # makes the value from its text; raises InputError
    text: str | None = None  # the default as a user would write it, if the option is parsed
    min: float | None = None  # least allowed value
    above: float | None = None  # the value must be larger
    max: float | None = None  # largest allowed value
    unit: str = ""  # of these, after a blank, in an error
    type: Any = None  # click's type, for a text with a special role, such as an output's path
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
    """The type of each field of a dataclass, without "or None", and whether None is allowed.

    The types must be importable at run time, not only under TYPE_CHECKING.
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

    For `__post_init__` of option dataclasses. None passes if it is the default or of the type.
    """
    cls: Any = type(options)
    for entry in fields(options):
        name = ArgumentName(entry.name)
        info = option_info(entry)
        value = getattr(options, entry.name)
        kind, optional = field_types(cls)[name]
        if value is None and (optional or entry.default is None):
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
                raise InputError(name, f"must be {' and '.join(texts)}{info.unit}, not {value}")


def check_type(value: Any, kind: Any, name: str) -> None:
    """Raise InputError, naming the argument, if a value is not of the type `kind`: a class, such as
    bool, int, float, str or Path, or a union or a tuple of classes."""
    if type(value) is kind:  # as nearly always, and quickly
        return
    kinds: tuple[Any, ...] = (kind,)
    parts = (value,)
    if get_origin(kind) in (Union, UnionType):
        kinds = get_args(kind)
    elif get_origin(kind) is tuple:
        inner = get_args(kind)
        if not isinstance(value, tuple) or inner[-1] is not Ellipsis and len(inner) != len(value):
            words = "a tuple" if inner[-1] is Ellipsis else f"a tuple of {len(inner)}"
            raise InputError(ArgumentName(name), f"must be {words}, not {value!r}")
        kinds = inner[:1]
        parts = value
    if not all(isinstance(kind, type) for kind in kinds):
        return
    allowed = tuple(_NUMBERS.get(kind, kind) for kind in kinds)
    for part in parts:
        if not isinstance(part, allowed) or (isinstance(part, bool) and bool not in kinds):
            names = " or ".join(_TYPE_NAMES.get(kind, f"a {kind.__name__}") for kind in kinds)
            shown = repr(part) if isinstance(part, str | Real | None) else type(part).__name__
            raise InputError(ArgumentName(name), f"must be {names}, not {shown}")
