"""Command-line options made of the fields of a dataclass.

    @click.command()
    @dataclass_options(EstimationOptions, "estimation")
    def estimate(estimation: EstimationOptions) -> None: ...

gives the command an option for each field of `EstimationOptions` that was made by
`dgc_pose.system.options.option` with a help text, and passes it an instance. A field whose type is
a dataclass contributes the options of that class.
"""

import functools
import re
from collections.abc import Callable, Collection, Iterator, Mapping
from dataclasses import MISSING, fields, is_dataclass
from pathlib import Path
from typing import Any, Literal, get_args, get_origin

import click

from dgc_pose.cli.guard import NamedPath, SectionedOption
from dgc_pose.system.options import OptionInfo, check_options, field_types, option_info

_FILE = re.compile(r"PATH|DIR|FILE")  # in the metavar of an option that is the name of a file
Command = Callable[..., Any]
Decorator = Callable[[Command], Command]


def dataclass_options(
    cls: type, argument: str, *, only: Collection[str] | None = None
) -> Decorator:
    """A decorator that adds the options of `cls` and passes an instance as keyword `argument`.

    only: names of the fields that become options; None: all with a help text. The other fields have
    their defaults.

    The type decides the option: bool is a switch (--x, or --x/--no-x if it is True by default),
    Literal a choice, tuple[X, ...] may be given several times. `check_options` checks the instance.
    """
    chosen = dict(_options(cls, argument, only))

    def decorate(command: Command) -> Command:
        @functools.wraps(command)
        def with_instance(**kwargs: Any) -> Any:
            values = {name: kwargs.pop(name) for name in chosen}
            return command(**kwargs, **{argument: _made(cls, values, argument)})

        decorated: Command = with_instance
        for decorator in reversed(chosen.values()):
            decorated = decorator(decorated)
        return decorated

    return decorate


def _options(
    cls: type, path: str, only: Collection[str] | None = None
) -> Iterator[tuple[str, Decorator]]:
    """The options by the name of the command's parameter: the path of fields, joined by "__"."""
    for field in fields(cls):
        kind, optional = field_types(cls)[field.name]
        name, info = f"{path}__{field.name}", option_info(field)
        if only is not None and field.name not in only:
            continue
        if info is None or not info.help:
            if isinstance(kind, type) and is_dataclass(kind) and not optional:
                yield from _options(kind, name)
            continue
        flag = info.flag or "--" + field.name.replace("_", "-")
        settings: dict[str, Any] = {"required": field.default is MISSING}
        if field.default is not MISSING:
            settings["default"] = field.default if info.text is None else info.text
        if kind is bool:
            flag += "/--no-" + flag[2:] if field.default else ""
            settings["is_flag"] = True
        elif get_origin(kind) is tuple and info.parse is None:
            settings |= {"multiple": True, "type": _parameter_type(get_args(kind)[0], info)}
        else:
            settings["type"] = _parameter_type(kind, info)
            settings["show_default"] = settings.get("default") is not None
        settings |= {"help": info.help, "metavar": info.metavar, "section": info.section}
        yield name, click.option(flag, name, cls=SectionedOption, **settings)


def _made(cls: type, values: Mapping[str, Any], path: str) -> Any:
    """An instance with the values of the options, which `_options` named."""
    arguments: dict[str, Any] = {}
    for field in fields(cls):
        name = f"{path}__{field.name}"
        if name in values:
            arguments[field.name] = values[name]
        elif any(other.startswith(name + "__") for other in values):
            arguments[field.name] = _made(field_types(cls)[field.name][0], values, name)
    made = cls(**arguments)
    check_options(made)
    return made


def _parameter_type(kind: Any, info: OptionInfo) -> Any:
    """The type of a parameter of click."""
    if info.type is not None:
        return info.type
    if info.parse is not None:
        return _Parsed(info.parse)
    if get_origin(kind) is Literal:
        return click.Choice(get_args(kind))
    if kind is Path or (kind is str and _FILE.search(info.metavar or "")):
        # The value of an option such as K|FILE stays text, but may be an input.
        return click.Path() if "|" in (info.metavar or "") else NamedPath(path_type=kind)
    return kind


class _Parsed(click.types.FuncParamType):
    """Parses a text by the option's function, whose InputError reaches the user as it is."""

    def convert(self, value: Any, param: Any, ctx: Any) -> Any:
        return self.func(value) if isinstance(value, str) else value
